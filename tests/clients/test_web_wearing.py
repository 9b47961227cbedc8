"""How @drape/client wears garments: what it asks of a stream as they are opened, and what may be set after that."""

from __future__ import annotations

from pathlib import Path

from tests.clients.node import answer_of

OWN = """
import { Wearing } from "./wearing.js";
import { Stream } from "./stream.js";
const asked = [];
const makeStream = (heard) => new Stream({ base: "http://nowhere", ticket: async () => "", ...heard });
const rest = { garmentMesh: async (id) => Promise.reject(new Error(id)) };
const wearing = new Wearing({ makeStream, rest, worn: new Set() }, input.named, input.options);
wearing.stream.open = ({ past, ...opening }) => {
  asked.push(opening);
  wearing.stream.opened = input.opened;
  wearing.stream.onState("open", null);
};
const failed = await wearing.open(null).catch((error) => error.message); // of the first mesh that is fetched
const before = asked.splice(0);
await wearing.set({ ...input.options, fabric: ["silk"] });
const sizes = wearing.garments.map((id) => wearing.sizeOf(id));
const set = asked.shift();
const kept = [];
for (const other of [{ size: "S" }, { hidden: ["shirt"] }]) {
  await wearing.set(other).catch(({ name }) => kept.push(name));
}
console.log(JSON.stringify({ asked: before, failed, set, sizes, kept, after: asked }));
"""


def test_own_clothes_are_named_by_the_answer_and_lists_of_options_go_with_them(tmp_path: Path):
    """The service says which of an avatar's own clothes lie below and over what was named."""
    options = {"avatar": "me", "alive": True, "size": ["L"], "fabric": ["denim"], "tier": "fast"}
    opened = {"garments": [{"id": "me~trousers"}, {"id": "shirt"}, {"id": "me~outer"}]}
    told = answer_of(OWN, {"named": ["shirt"], "options": options, "opened": opened}, tmp_path)
    first, second = told["asked"]
    assert first == {"garment": "shirt", "size": ["L"], "avatar": "me", "alive": True, "tier": "fast"}
    garments, each = ["me~trousers", "shirt", "me~outer"], {"size": [None, "L", None]}
    whole = {"garments": garments, "avatar": "me", "tier": "fast", **each}
    assert second == whole | {"fabric": [None, "denim", None]}
    assert told["set"] == whole | {"fabric": [None, "silk", None]}
    assert told["sizes"] == [None, "L", None] and told["failed"] == "me~trousers"
    assert told["kept"] == ["size", "hidden"] and told["after"] == []  # other meshes would come
    alone = {"named": [], "options": {"avatar": "me", "alive": True}, "opened": {"garment": "me~dress"}}
    first, second = answer_of(OWN, alone, tmp_path)["asked"]
    assert first == {"avatar": "me", "alive": True} and second == {"garment": "me~dress", "avatar": "me"}
