"""@drape/client as others get it: packed, installed, type-checked, run; and the poses that it reads from rigs."""

from __future__ import annotations

import gzip
import json
import re
import shutil
import tarfile
from pathlib import Path

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.model import BodyModel
from drape.body.skeleton import PARENTS
from tests.architecture.repository import ROOT
from tests.clients.installed import WEB, install, node_with_sockets, run

CONSUMER = ROOT / "tests/clients/web/consumer.ts"
OPTIONS = {
    "strict": True,
    "noUncheckedIndexedAccess": True,
    "target": "es2022",
    "module": "nodenext",
    "moduleResolution": "nodenext",
    "lib": ["es2023", "dom", "dom.iterable"],
    "types": [],
}
CORE_LIMIT_BYTES = 44_000


@pytest.fixture(scope="module")
def application(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(tmp_path_factory.mktemp("application"))


def test_an_application_in_strict_typescript_wears_a_garment(application: Path, live: str):
    shutil.copy(CONSUMER, application)
    (application / "tsconfig.json").write_text(json.dumps({"compilerOptions": OPTIONS, "files": ["consumer.ts"]}))
    run(["node", str(WEB / "node_modules/typescript/bin/tsc"), "-p", "."], application)
    said = json.loads(run([*node_with_sockets(), "consumer.js", live], application))
    assert said["garments"] == ["tube"]
    assert said["refused"] == ["passes", "InputError", 400, True]
    assert said["unknown"] == ["garment", "NotFound", 404, True]
    assert said["noRig"] == ["rig", "InputError", 0, True]
    assert said["noFolder"] == ["about.json", "NotFound", 0, True]
    assert [said[name][0] for name in ("server", "client")] == ["server", "client"] and said["fallen"] == "server"
    assert said["alone"] == ["folds_by", "InputError", 400, True]
    both = [np.reshape(said[name][1], (-1, 3)) for name in ("server", "client")]
    # Poses come as fast as each answers, and cloth swings by the clock: test_engine_web.py holds equal times to less.
    assert np.sqrt(np.square(both[0] - both[1]).sum(axis=1).mean()) < 1e-2
    assert said["frames"] >= 3 and said["state"] == "closed" and said["children"] == 0
    for positions in (np.reshape(said[name], (-1, 3)) for name in ("positions", "jets")):
        assert len(positions) >= httpx.get(live + "/garments/tube").json()["vertices"]
        assert 0.1 < np.ptp(positions, axis=0).max() < 2.0
    assert 0.5 < said["root"][1] < 1.5


def test_the_tarball_has_types_first_and_nothing_but_its_build(application: Path):
    with tarfile.open(next(application.glob("*.tgz"))) as tarball:
        names = tarball.getnames()
    beside = {name for name in names if not name.startswith("package/dist/")}
    assert beside == {"package/package.json", "package/README.md", "package/LICENSE"}
    manifest = json.loads((WEB / "lib/package.json").read_text())
    for entry in manifest["exports"].values():
        assert list(entry) == ["types", "default"]
        assert all(f"package/{path.removeprefix('./')}" in names for path in entry.values())


def test_what_was_packed_is_up_to_date_still(application: Path):
    assert (WEB / "lib/LICENSE").is_file()  # npm wrote it
    run(["scripts/build_page", "clients/web", "--check"], ROOT)


def test_the_core_is_small(application: Path):
    folder = application / "node_modules/@drape/client/dist"
    named = [f"{name}.js" for name in ("core", "index", "react", "three", "worker")]
    files: dict[Path, None] = {}  # without what comes when it is needed: folds, and what makes them
    while named:
        files[path := folder / named.pop()] = None
        imported = re.findall(r'(?:from|import) "\./([^"]+)"', path.read_text())
        named += [name for name in imported if folder / name not in files]
    whole = b"".join(path.read_bytes() for path in files)
    assert len(gzip.compress(whole)) < CORE_LIMIT_BYTES  # not even minified, the adapters with it
    assert all(b"ENGINE_TEXT" not in path.read_bytes() and b"H4sI" not in path.read_bytes() for path in files)


RIG = """
import { Bone, Group, Object3D, Quaternion, Scene, SkinnedMesh, Skeleton, Vector3 } from "three";
import { rigSource } from "@drape/client/three";
const input = JSON.parse(process.argv[2]);
const { names, parents, places, turns, poses, yaw, scale, step } = input;
const model = new Group();
const bones = names.map((name, joint) => {
  if (!name) return null;
  const bone = Object.assign(new Bone(), { name });
  let above = parents[joint];
  while (above >= 0 && !names[above]) above = parents[above];
  let parent = above < 0 ? model : made[above];
  if (joint === input.between) {  // a bone that is no joint, with axes of its own
    const twist = new Bone();
    twist.quaternion.set(...turns[0]).normalize();
    parent.add(twist);
    parent = twist;
  }
  parent.add(bone);
  bone.quaternion.set(...turns[joint]).normalize();
  bone.position.copy(parent.worldToLocal(new Vector3(...places[joint])));
  bone.updateWorldMatrix(true, true);
  made[joint] = bone;
  return bone;
}, globalThis.made = []);
const rest = bones.map((bone) => bone && [bone.parent.getWorldQuaternion(new Quaternion()), bone.quaternion.clone()]);
let rig = model;
if (input.skinned) {
  rig = new SkinnedMesh();
  model.add(rig);
  rig.bind(new Skeleton(bones.filter(Boolean)));
}
model.rotation.y = yaw;
model.scale.setScalar(scale);
const frame = new Group().add(model);
frame.position.set(3, 0, -2);
new Scene().add(frame);
const source = rigSource(input.vrm ? { humanoid: { getRawBoneNode: (name) => made[names.indexOf(name)] } } : rig);
await source.begin({ body: async () => ({ joints: places, floor_m: -0.9 }) });
const axis = new Vector3();
bones.forEach((bone, joint) => {
  if (!bone) return;
  const angle = axis.fromArray(poses[joint]).length();
  const turn = new Quaternion().setFromAxisAngle(axis.divideScalar(angle || 1), angle);
  const [above, local] = rest[joint];
  bone.quaternion.copy(above).invert().multiply(turn).multiply(above).multiply(local);
});
bones[0].position.add(new Vector3(...step));
const { poses: got, trans } = source.sample(0);
console.log(JSON.stringify({ poses: [...got], trans }));
"""

VRM = (
    "hips leftUpperLeg rightUpperLeg spine leftLowerLeg rightLowerLeg chest leftFoot rightFoot upperChest leftToes "
    "rightToes neck leftShoulder rightShoulder head leftUpperArm rightUpperArm leftLowerArm rightLowerArm "
    "leftHand rightHand"
)
MIXAMO = (
    "Hips LeftUpLeg RightUpLeg Spine LeftLeg RightLeg Spine1 LeftFoot RightFoot Spine2 LeftToeBase RightToeBase Neck "
    "LeftShoulder RightShoulder Head LeftArm RightArm LeftForeArm RightForeArm LeftHand RightHand"
)


@pytest.mark.parametrize("rig", ["vrm", "vrm that looks back", "mixamo", "few bones"])
def test_poses_of_a_rig_are_those_that_it_was_put_into(application: Path, body: BodyModel, rng, rig: str):
    names: list[str | None] = [f"mixamorig{name}" for name in MIXAMO.split()] if rig == "mixamo" else [*VRM.split()]
    poses = rng.uniform(-1.0, 1.0, (24, 3))
    missing = [6, 9, 10, 11, 12, 13, 14] if rig == "few bones" else []
    for joint in missing:
        names[joint] = None
    poses[[*missing, 22, 23]] = 0.0
    places = body.rest_joints(np.zeros(10))
    step = rng.uniform(-1.0, 1.0, 3)
    document = {
        "names": names, "parents": PARENTS, "places": places.tolist(), "turns": rng.normal(size=(24, 4)).tolist(),
        "poses": poses.tolist(), "yaw": np.pi if "back" in rig else 0.4, "scale": 0.01 if rig == "mixamo" else 1.0,
        "step": step.tolist(), "between": 18, "skinned": rig == "mixamo", "vrm": rig.startswith("vrm"),
    }  # fmt: skip
    (application / "rig.js").write_text(RIG)
    said = json.loads(run(["node", "rig.js", json.dumps(document)], application))
    assert_allclose(np.reshape(said["poses"], (24, 3)), poses, rtol=0, atol=1e-6)  # float32
    assert_allclose(said["trans"], step + np.array([0.0, 0.9, 0.0]), rtol=0, atol=1e-9)
