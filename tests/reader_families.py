"""Everything that reads files from elsewhere: a small valid sample of each, made by our own writers, and its reader.

`outcome` says what a reader made of a file: a value, or one of our own errors that names the file. Anything else passes
through it. Both the tests of `hypothesis` and `benchmarks/fuzz_readers.py` use it.
"""

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mini_release import SPLITS, TEST, write_release

from assemblyhands_core.data.assembly101 import write_assembly101_calibration
from assemblyhands_core.data.assembly101_poses import (
    Assembly101Poses,
    read_assembly101_poses,
    write_assembly101_poses,
)
from assemblyhands_core.data.assemblyhands import read_ego_calibration, read_joint_annotations
from assemblyhands_core.data.assemblyhands_images import read_ego_images
from assemblyhands_core.data.assemblyhands_rig import read_skeleton, write_exo_calibration, write_skeleton
from assemblyhands_core.data.coco_keypoints import CocoHand, CocoPicture, read_coco_keypoints, write_coco_keypoints
from assemblyhands_core.data.correction_file import Correction, read_corrections, write_corrections
from assemblyhands_core.data.crop_images import encode_jpeg, read_picture
from assemblyhands_core.data.digests import digest_json
from assemblyhands_core.data.fine_grained import (
    Action,
    Segment,
    read_fine_grained,
    write_fine_grained_30fps,
    write_fine_grained_60fps,
)
from assemblyhands_core.data.layout import read_split
from assemblyhands_core.data.pose_sequences import REFERENCE
from assemblyhands_core.data.rigs import read_calibration
from assemblyhands_core.data.store import DamagedEntry, Store
from assemblyhands_core.data.tables import TableSpec
from assemblyhands_core.detectors.precomputed import PrecomputedBody, PrecomputedHands
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.distortion import OpenCVLens, OVFishEye62, Pinhole
from assemblyhands_core.models import torchvision_operators  # noqa: F401  (before what imports torchvision)
from pipeline.manifests import select_rows

SIZE_PX = (16, 12)
_SPEC = TableSpec("films", 1, ("frame",), pa.schema([("frame", pa.int64()), ("film_file", pa.string())]))
_PARTS = {"stage": "film", "config": {"a": 1}}
_MANIFEST = "sequence_id,split,calibration,videos,package\nmonday,test,calib.json,*.mp4,\n"

_ANIPOSE = """[cam_0]
name = "left"
size = [640, 480]
matrix = [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [-0.1, 0.01, 0.001, 0.0, 0.0]
rotation = [0.1, 0.2, 0.3]
translation = [0.0, 0.0, 0.0]

[cam_1]
name = "right"
size = [640, 480]
matrix = [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [-300.0, 0.0, 0.0]

[metadata]
adjusted = false
error = 0.5
"""
_QUALISYS = """<?xml version='1.0' encoding='ASCII'?>
<calibration qtm-version="2020.3" type="regular"><cameras><camera serial="cam01" active="1" model="none">
<fov_video left="10" top="20" right="1097" bottom="1939"/>
<transform r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1" x="1000" y="2000" z="3000"/>
<intrinsic focalLengthU="64000" focalLengthV="128000" centerPointU="35200" centerPointV="62080"
 radialDistortion1="-0.05" radialDistortion2="0.14" radialDistortion3="0.01"
 tangentalDistortion1="0.001" tangentalDistortion2="-0.002" skew="0.0"/>
</camera></cameras></calibration>
"""


class NotOurs(AssertionError):
    """A reader let an error through that is not ours, or one that does not name the file."""


@dataclass(frozen=True)
class Family:
    """A kind of file.

    Attributes:
        name: Of the file, and so of the family.
        samples: Valid contents.
        read: Reads a file, and uses what it gave where that is lazy.
        names_file: Whether its errors have to name the file; others leave that to who asked.
    """

    name: str
    samples: tuple[bytes, ...]
    read: Callable[[Path], object]
    names_file: bool = True


def outcome(family: Family, content: bytes, folder: Path) -> str:
    """Return `value`, or the sentence of our own error.

    Raises:
        NotOurs: The error was another one, or its sentence does not name the file or cannot be printed.
    """
    path = folder / family.name
    path.write_bytes(content)
    try:
        family.read(path)
    except (ValueError, DamagedEntry) as error:
        kind, said = type(error), str(error)
        if kind is not ValueError and not kind.__module__.startswith(("assemblyhands_core.", "pipeline.", "stages.")):
            raise NotOurs(f"{family.name}: {kind.__module__}.{kind.__name__}: {said}") from error
        if family.names_file and str(folder) not in said:
            raise NotOurs(f"{family.name}: the file is not named: {said}") from error
        said.encode()
        return said
    except Exception as error:
        raise NotOurs(f"{family.name}: {type(error).__name__}: {error}") from error
    return "value"


def families() -> dict[str, Family]:
    """Return all of them by name."""
    with tempfile.TemporaryDirectory() as folder:
        found = [*_calibrations(Path(folder)), *_annotations(Path(folder)), *_lists(Path(folder))]
        found += [*_pictures(), *_tables(Path(folder)), *_weights(Path(folder))]
    return {family.name: family for family in found}


def _written(folder: Path, write: Callable[..., object], *arguments: Any) -> bytes:
    path = folder / "written"
    write(path, *arguments)
    return path.read_bytes()


def _camera(name: str, lens: Any) -> Camera:
    return Camera(name, 640, 480, 500.0, 510.0, 320.0, 240.0, lens, np.eye(4))


def _used(path: Path) -> object:
    points = np.array([[0.0, 0.0, 1000.0], [300.0, 100.0, 1000.0], [0.0, 0.0, -1.0]])
    return [(camera.unproject(camera.project(points)), camera.K) for camera in read_calibration(path).values()]


def _calibrations(folder: Path) -> list[Family]:
    fisheye = OVFishEye62(0.1, 0.01, 0.001, 0.0, 0.0, 0.0, 0.0001, 0.0001)
    cameras = [_camera("C10095", OpenCVLens(k1=-0.1, k2=0.01)), _camera("21110305_mono10bit", fisheye)]
    assembly101 = _written(folder, write_assembly101_calibration, cameras)
    exo = _written(folder, write_exo_calibration, [_camera("C10095", Pinhole()), _camera("C10115", Pinhole())])
    pose2sim = _ANIPOSE.replace("[metadata]", "fisheye = false\n[metadata]").replace(
        "[cam_1]", "fisheye = false\n[cam_1]"
    )
    return [
        Family("assembly101.json", (assembly101,), _used),
        Family("calib.txt", (exo,), _used),
        Family("anipose.toml", (_ANIPOSE.encode(),), _used),
        Family("pose2sim.toml", (pose2sim.encode(),), _used),
        Family("rig.qca.txt", (_QUALISYS.encode(),), _used),
    ]


def _annotations(folder: Path) -> list[Family]:
    layout = write_release(folder / "release")
    split = SPLITS[TEST]
    joints, ego, images = (layout.annotations(split, k).read_bytes() for k in ("joint_3d", "ego_calib", "ego_data"))
    landmarks = np.zeros((3, 2, 21, 3), np.float32)
    poses = _written(folder, write_assembly101_poses, Assembly101Poses(landmarks, np.ones((3, 2), np.float32)))
    hand = CocoHand("left", np.full((21, 2), 5.0), np.ones(21, dtype=bool), (1.0, 2.0, 3.0, 4.0))
    coco = _written(folder, write_coco_keypoints, [CocoPicture("a--b--000001--abcdef01.jpg", (64, 48), (hand,))])
    person = {"pose_keypoints_2d": [1.0, 2.0, 0.5] * 25, "hand_left_keypoints_2d": [1.0, 2.0, 0.5] * 21}
    return [
        Family("joint_3d.json", (_fewer(joints, "annotations", "world_coord"),), read_joint_annotations),
        Family("ego_calib.json", (_fewer(ego, "calibration", "extrinsics"),), read_ego_calibration),
        Family("ego_data.json", (_few_images(images),), read_ego_images),
        Family("poses.json", (poses,), read_assembly101_poses),
        Family("corrected.json", (coco,), read_coco_keypoints),
        Family("x_000_keypoints.json", (json.dumps({"version": 1.3, "people": [person]}).encode(),), _openpose),
    ]


def _fewer(content: bytes, key: str, kind: str) -> bytes:
    """Keep two frames of a recording's eight, so that samples are small."""
    document = json.loads(content)
    for name, block in document[key].items():
        frames = block.get(kind, block)
        few = {frame: frames[frame] for frame in list(frames)[:2]}
        document[key][name] = {**block, kind: few} if kind in block else few
    return json.dumps(document).encode()


def _few_images(content: bytes) -> bytes:
    document = json.loads(content)
    return json.dumps({name: blocks[:2] for name, blocks in document.items()}).encode()


def _openpose(path: Path) -> object:
    folder = path.parent / "openpose"
    (folder / "cam").mkdir(parents=True, exist_ok=True)
    (folder / "cam" / path.name).write_bytes(path.read_bytes())
    body = PrecomputedBody(folder).detect(None, "cam", 0)
    return body, PrecomputedHands(folder).detect(None, "left", "cam", 0)


def _lists(folder: Path) -> list[Family]:
    action = Action("pick up", "wheel", 0, 3, 7, "pick up wheel")
    segment = Segment(TEST, 10, 20, 60, action, "a23", "car", False, ("C10095_rgb", "HMC_21110305_mono10bit"))
    corrections = [Correction("monday", 7, "front", "right", "index_tip", 12.25, -0.5, 2)]
    corrections.append(replace(corrections[0], joint="wrist", x_px=np.nan, y_px=np.nan, visibility=0))
    actions = (
        _written(folder, write_fine_grained_30fps, [segment]),
        _written(folder, write_fine_grained_60fps, [replace(segment, views=())]),
    )
    return [
        Family("actions.csv", actions, read_fine_grained),
        Family("monday.csv", (_written(folder, write_corrections, corrections),), read_corrections),
        Family("manifest.csv", (_MANIFEST.encode(),), _rows),
        Family("val.txt", (f"{TEST}\n".encode(),), read_split),
        Family("skeleton.txt", (_written(folder, write_skeleton),), read_skeleton),
    ]


def _rows(path: Path) -> object:
    try:
        return select_rows(SimpleNamespace(manifest=str(path), seq="all"))  # type: ignore[arg-type]
    except ValueError as error:
        if "cannot name a sequence" in str(error):  # says which; the manifest is the one that was given
            return None
        raise


def _pictures() -> list[Family]:
    import cv2

    image = np.random.default_rng(0).integers(0, 256, (SIZE_PX[1], SIZE_PX[0], 3), dtype=np.uint8)
    progressive = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    png = cv2.imencode(".png", image)[1].tobytes()
    grey = cv2.imencode(".png", image[:, :, 0])[1].tobytes()
    return [
        Family("picture.jpg", (encode_jpeg(image, 90), progressive), lambda path: read_picture(path, SIZE_PX)),
        Family("picture.png", (png, grey), lambda path: read_picture(path, SIZE_PX)),
    ]


def _tables(folder: Path) -> list[Family]:
    hands = pa.table(
        {
            "camera": ["cam", "cam"], "frame": [0, 1], "hand": ["left", "right"],
            "keypoints_px": [[1.0] * 42] * 2, "confidence": [[0.5] * 21] * 2,
        }
    )  # fmt: skip
    pq.write_table(hands, folder / "hands.parquet")
    store = Store(folder / "work")
    with store.draft("film", _PARTS) as draft:
        (draft.folder / "a.mp4").write_bytes(b"film")
        draft.write({"films": (_SPEC, _SPEC.build({"frame": [0, 1], "film_file": ["a.mp4"] * 2}))}, 1.5)
    entry = store.entry("film", digest_json(_PARTS))
    whole = {path.name: path.read_bytes() for path in sorted(entry.iterdir())}
    return [
        Family("hands.parquet", ((folder / "hands.parquet").read_bytes(),), _precomputed),
        Family("record.json", (whole["record.json"],), lambda path: _from_store(path, whole)),
        Family("films.parquet", (whole["films.parquet"],), lambda path: _from_store(path, whole)),
    ]


def _precomputed(path: Path) -> object:
    return PrecomputedHands(path).detect(None, "left", "cam", 0)


def _from_store(path: Path, whole: Mapping[str, bytes]) -> object:
    """Read an entry of a store in which one file is another; what is not whole is set aside."""
    store = Store(path.parent / "work")
    shutil.rmtree(store.root, ignore_errors=True)
    entry = store.entry("film", digest_json(_PARTS))
    entry.mkdir(parents=True)
    for name, content in {**whole, path.name: path.read_bytes()}.items():
        (entry / name).write_bytes(content)
    record = store.find("film", entry.name)
    return record and {name: store.read(record, name, _SPEC) for name in record.outputs}


def _weights(folder: Path) -> list[Family]:
    import torch

    from assemblyhands_core.models.msg3d import MSG3D, MSG3DConfig
    from assemblyhands_core.models.pretrained import save_weights
    from assemblyhands_core.models.verb_classification import VerbClassifier

    torch.manual_seed(0)
    network = MSG3D(MSG3DConfig(num_classes=2, num_gcn_scales=2, num_g3d_scales=2, c1=6, c2=6, c3=6))
    card = {"classifier": json.dumps({"verbs": ["a", "b"], "nouns": [], "sequence": asdict(REFERENCE)})}
    return [Family("verbs.safetensors", (_written(folder, save_weights, network, card),), VerbClassifier.load)]
