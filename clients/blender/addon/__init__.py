# SPDX-License-Identifier: Apache-2.0 OR GPL-3.0-or-later
# pyright: reportMissingImports=false, reportInvalidTypeForm=false, reportAttributeAccessIssue=false
"""Drape: garments on armatures, from a service, baked to the timeline. The panel, its settings, its buttons."""

from __future__ import annotations

import time
from typing import Any

import bpy
from bpy.props import EnumProperty, PointerProperty, StringProperty

from .bake import Step, Steps, bake
from .garment_object import FORMS
from .local_service import LocalService
from .our_body import add_our_body
from .service_calls import Refusal, Service

TICK_S = 0.02
LISTS = ("garments", "tiers", "fabrics", "motions")
known: dict[str, list[str]] = {name: [] for name in LISTS}  # ids that the service has, as of the last Connect
started: list[LocalService] = []  # the service of this Blender


def name_property(name: str, which: str, description: str = "") -> Any:
    """Returns a text property of the panel called ``name``. It suggests the ids in the list ``which``, one of
    ``LISTS``; a user may type others."""
    listed = {"search": lambda self, context, text: known[which], "search_options": {"SUGGESTION"}}
    return StringProperty(name=name, description=description, **listed)


class Preferences(bpy.types.AddonPreferences):
    """The add-on's preferences: the address of the service and the key, or the environment that starts one."""

    bl_idname = __package__
    url: StringProperty(name="Address", default="http://127.0.0.1:8000")
    key: StringProperty(name="Key", subtype="PASSWORD", description="Of a service that asks who you are")
    environment: StringProperty(name="Environment", subtype="DIR_PATH", description="Of Python, with drape installed")

    def draw(self, context: Any) -> None:
        for name in ("url", "key", "environment"):
            self.layout.prop(self, name)


class SceneSettings(bpy.types.PropertyGroup):
    """The panel's settings of a scene: the character, what it wears, and how that is baked."""

    armature: PointerProperty(
        name="Character", type=bpy.types.Object, poll=lambda self, thing: thing.type == "ARMATURE"
    )
    garment: name_property("Garment", "garments")
    tier: name_property("Tier", "tiers", "How much is computed; empty: the service's own")
    fabric: name_property("Fabric", "fabrics", "What it is made of; empty: its own")
    motion: name_property("Motion", "motions", "Of our body; empty: none")
    form: EnumProperty(name="Bake to", items=FORMS)


def service_of(context: Any) -> Service:
    """Returns the service that the preferences name; refuses (``Refusal``) another machine without Online Access."""
    preferences = context.preferences.addons[__package__].preferences
    service = Service(preferences.url, preferences.key)
    if not (service.is_local or bpy.app.online_access):
        cure = "Allow Online Access in the preferences (System), or use a service on this machine."
        raise Refusal("network", expected="leave to ask other machines", got="none", cure=cure)
    return service


class Stepped:
    """An operator of Blender. Its work is the generator ``steps(context)`` of its subclass, which yields each ``Step``.
    A script runs it to its end; a button runs it while Blender goes on, and Esc ends it."""

    @classmethod
    def poll(cls, context: Any) -> bool:
        return context.mode in ("OBJECT", "POSE")  # bones do not pose while they are edited

    def execute(self, context: Any) -> set[str]:
        self.left = self.steps(context)
        while (state := self._step()) == "RUNNING_MODAL":
            time.sleep(self.step.waits * TICK_S)
        return {state}

    def invoke(self, context: Any, event: Any) -> set[str]:
        self.left, self.step = self.steps(context), Step(0.0, "")
        self.timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        state = self._step() if event.type == "TIMER" else "RUNNING_MODAL"
        if event.type == "ESC":
            self.left.close()
            state = "CANCELLED"
        goes_on = state == "RUNNING_MODAL"
        words = f"{100 * self.step.share:.0f} %  {self.step.words}   |   Esc: cancel"
        context.workspace.status_text_set(words if goes_on else None)
        if not goes_on:
            context.window_manager.event_timer_remove(self.timer)
        return {state}

    def _step(self) -> str:
        try:
            self.step = next(self.left)
        except StopIteration:
            return "FINISHED"
        except Refusal as refusal:
            self.report({"ERROR"}, str(refusal))
            return "CANCELLED"
        return "RUNNING_MODAL"


class Connect(Stepped, bpy.types.Operator):
    """Ask the service what it has"""

    bl_idname, bl_label = "drape.connect", "Connect"

    def steps(self, context: Any) -> Steps:
        service = service_of(context)
        for number, name in enumerate(LISTS):
            yield Step(number / len(LISTS), name)
            ids = (entry["id"] for entry in service.json(name))
            known[name] = [own for own in ids if own != "exact"]  # that tier is a job of hours


class Start(Stepped, bpy.types.Operator):
    """Start a service from the environment that the preferences name, or end it"""

    bl_idname, bl_label = "drape.start", "Start or end a service"

    def steps(self, context: Any) -> Steps:
        preferences = context.preferences.addons[__package__].preferences
        if started:
            return started.pop().end()
        started.append(LocalService(preferences.environment))
        try:
            while not started[0].ready():
                yield Step(0.0, "The service starts", waits=True)
        except BaseException:
            started.pop().end()
            raise
        preferences.url = started[0].url
        yield from Connect.steps(self, context)


class AddBody(Stepped, bpy.types.Operator):
    """Add the service's own body (CC0) in the motion that is chosen"""

    bl_idname, bl_label, bl_options = "drape.add_body", "Add our body", {"REGISTER", "UNDO"}

    def steps(self, context: Any) -> Steps:
        yield Step(0.0, "Adding the body")
        context.scene.drape.armature = add_our_body(context, service_of(context), context.scene.drape.motion)


class Bake(Stepped, bpy.types.Operator):
    """Drape the garment over the frames of the scene"""

    bl_idname, bl_label, bl_options = "drape.bake", "Bake", {"REGISTER", "UNDO"}

    def steps(self, context: Any) -> Steps:
        yield from bake(context, service_of(context), context.scene.drape)


class DrapePanel(bpy.types.Panel):
    """The panel of the add-on in the sidebar of the 3D view: settings and buttons."""

    bl_idname, bl_label, bl_category = "DRAPE_PT_panel", "Drape", "Drape"
    bl_space_type, bl_region_type = "VIEW_3D", "UI"

    def draw(self, context: Any) -> None:
        self.layout.operator("drape.start", text="End the service" if started else "Start a service")
        for name in ("drape.connect", "motion", "drape.add_body", "armature", "garment", "tier", "fabric", "form"):
            self.layout.operator(name) if "." in name else self.layout.prop(context.scene.drape, name)
        self.layout.operator("drape.bake")


CLASSES = (Preferences, SceneSettings, Connect, Start, AddBody, Bake, DrapePanel)


def register() -> None:
    """Adds the add-on's classes and the scene's settings to Blender, which calls it."""
    for kind in CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.Scene.drape = PointerProperty(type=SceneSettings)


def unregister() -> None:
    """Removes what ``register`` has added, and ends the service that this Blender has started."""
    while started:
        started.pop().end()
    del bpy.types.Scene.drape
    for kind in reversed(CLASSES):
        bpy.utils.unregister_class(kind)
