"""Readers of files of 2D keypoints: every reader returns arrays of x, y, confidence."""

import re
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Float64

from assemblyhands_core.data.json_files import FormatError, read_json_object
from assemblyhands_core.data.tables import TableError, check_room
from assemblyhands_core.detectors.base import DetectorError, from_wrist_first
from assemblyhands_core.hands.body import NUM_BODY_KEYPOINTS
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, Hand

Triples = Float64[np.ndarray, "_keypoint 3"]  # x, y, confidence

_MAX_BYTES: Final = 2**24  # of one frame
# Which keypoint of a body of so many keypoints each COCO-17 keypoint is: COCO-17 itself, OpenPose COCO-18 and BODY_25,
# HALPE-26 and COCO-WholeBody (the last two begin with COCO-17).
_COCO: Final = tuple(range(NUM_BODY_KEYPOINTS))
COCO_FROM_BODY: Final = {
    17: _COCO,
    18: (0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10),
    25: (0, 16, 15, 18, 17, 5, 2, 6, 3, 7, 4, 12, 9, 13, 10, 14, 11),
    26: _COCO,
    133: _COCO,
}
# Where COCO-WholeBody keeps its hands, in OpenPose order.
_WHOLE_BODY: Final = 133
_WHOLE_BODY_HANDS: Final[dict[Hand, slice]] = {"left": slice(91, 112), "right": slice(112, 133)}


class OpenPoseFolder:
    """A folder with one folder per camera that holds one JSON file per frame."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, dict[int, Path]] = {}

    def bodies(self, camera_id: str, frame: int) -> Float64[np.ndarray, "detection keypoint=17 3"]:
        """Return the bodies in COCO-17 order."""
        found = [_coco_body(body) for body in self._people(camera_id, frame, "pose_keypoints_2d")]
        return np.stack(found) if found else np.empty((0, NUM_BODY_KEYPOINTS, 3))

    def hands(self, hand: Hand, camera_id: str, frame: int) -> Float64[np.ndarray, "detection joint=21 3"]:
        """Return the hands in AssemblyHands order."""
        found = self._people(camera_id, frame, f"hand_{hand}_keypoints_2d")
        whole = [body for body in self._people(camera_id, frame, "pose_keypoints_2d") if len(body) == _WHOLE_BODY]
        found += [body[_WHOLE_BODY_HANDS[hand]] for body in whole]
        return np.stack([from_wrist_first(h) for h in found]) if found else np.empty((0, NUM_JOINTS, 3))

    def _people(self, camera_id: str, frame: int, key: str) -> list[Triples]:
        """Return the keypoints under a key of the frame's file; a frame without file has nobody."""
        file = self._frames_of(camera_id).get(frame)
        if file is None:
            return []
        people = _read_json(file).get("people")
        if not isinstance(people, list):
            raise DetectorError(f"{file} has no list 'people': it is no OpenPose output.")
        if not all(isinstance(person, dict) for person in people):
            raise DetectorError(f"{file}: 'people' holds what is nobody's keypoints: it is no OpenPose output.")
        return [_triples(person[key], key, file) for person in people if person.get(key)]

    def _frames_of(self, camera_id: str) -> dict[int, Path]:
        if camera_id not in self._files:
            self._files[camera_id] = self._index(camera_id)
        return self._files[camera_id]

    def _index(self, camera_id: str) -> dict[int, Path]:
        folders = [folder for name in (camera_id, f"{camera_id}_json") if (folder := self._folder / name).is_dir()]
        if not folders:
            there = ", ".join(sorted(p.name for p in self._folder.iterdir() if p.is_dir())) or "none"
            raise DetectorError(
                f"{self._folder} has no folder {camera_id} or {camera_id}_json for camera {camera_id}: it has {there}."
            )
        frames: dict[int, Path] = {}
        for file in sorted(folders[0].glob("*.json")):
            numbers = re.findall(r"\d+", file.stem)
            if not numbers:
                raise DetectorError(f"{file} has no frame number in its name.")
            if int(numbers[-1]) in frames:
                raise DetectorError(f"{file} and {frames[int(numbers[-1])].name} are the same frame: remove one.")
            frames[int(numbers[-1])] = file
        return frames


class ParquetKeypoints:
    """A Parquet file with one row per camera, frame and person or hand."""

    def __init__(self, path: Path, kind: str, num_keypoints: int) -> None:
        self._kind = kind
        try:
            with pq.ParquetFile(path) as file:
                check_room(file, path)
            table = pq.read_table(path, columns=["camera", "frame", kind, "keypoints_px", "confidence"])
            table.validate(full=True)
            if any(table[name].null_count for name in table.column_names):
                raise pa.ArrowInvalid("there are holes in it")
            self._values = np.concatenate(
                [
                    _numbers(table, "keypoints_px", 2 * num_keypoints, path).reshape(-1, num_keypoints, 2),
                    _numbers(table, "confidence", num_keypoints, path)[..., None],
                ],
                axis=-1,
            )
        except (pa.ArrowException, OSError, TypeError, TableError, UnicodeDecodeError) as error:
            raise DetectorError(
                f"{path} cannot be read as keypoints with the columns camera, frame, {kind}, keypoints_px and "
                f"confidence: {error}"
            ) from error
        self._rows: dict[tuple[str, int], list[int]] = {}
        self._kinds = table[kind].to_pylist()
        self._check_hands(path)
        for row, key in enumerate(zip(table["camera"].to_pylist(), table["frame"].to_pylist(), strict=True)):
            self._rows.setdefault(key, []).append(row)
        self._cameras = {camera for camera, _ in self._rows}
        self._path = path

    def bodies(self, camera_id: str, frame: int) -> Float64[np.ndarray, "detection keypoint=17 3"]:
        """Return the bodies in COCO-17 order, by person."""
        return self._values[sorted(self._rows_of(camera_id, frame), key=lambda row: self._kinds[row])]

    def hands(self, hand: Hand, camera_id: str, frame: int) -> Float64[np.ndarray, "detection joint=21 3"]:
        """Return the hands in AssemblyHands order."""
        return self._values[[row for row in self._rows_of(camera_id, frame) if self._kinds[row] == hand]]

    def _rows_of(self, camera_id: str, frame: int) -> list[int]:
        if camera_id not in self._cameras:
            raise DetectorError(f"{self._path} has no camera {camera_id}: it has {', '.join(sorted(self._cameras))}.")
        return self._rows.get((camera_id, frame), [])

    def _check_hands(self, path: Path) -> None:
        if self._kind == "hand" and (strange := set(self._kinds) - set(HANDS)):
            raise DetectorError(f"{path} names a hand {sorted(map(str, strange))[0]!r}: only right and left are known.")


def _coco_body(body: Triples) -> Float64[np.ndarray, "keypoint=17 3"]:
    return body[list(COCO_FROM_BODY[len(body)])]


def _read_json(file: Path) -> dict[str, Any]:
    try:
        return read_json_object(file, _MAX_BYTES)
    except FormatError as error:
        raise DetectorError(str(error)) from error


def _triples(numbers: Any, key: str, file: Path) -> Triples:
    """Return the keypoints of OpenPose's flat list, checked."""
    try:
        values = np.asarray(numbers, dtype=np.float64).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError) as error:
        raise DetectorError(f"{file}: {key} is no flat list of x, y, confidence: {error}") from error
    known = COCO_FROM_BODY if key == "pose_keypoints_2d" else (NUM_JOINTS,)
    if len(values) not in known:
        raise DetectorError(f"{file}: {key} has {len(values)} keypoints; known are {', '.join(map(str, known))}.")
    return values


def _numbers(table: pa.Table, column: str, length: int, path: Path) -> Float64[np.ndarray, "row {length}"]:
    """Return the numbers of a list column."""
    lists = table[column].combine_chunks()
    lengths = set(pc.unique(pc.list_value_length(lists)).to_pylist())
    if lengths - {length}:
        wrong = next(iter(lengths - {length}))
        raise DetectorError(f"{path}: a row of {column} has {wrong} numbers instead of {length}.")
    flat = pc.list_flatten(lists).to_numpy(zero_copy_only=False)
    return np.asarray(flat, dtype=np.float64).reshape(-1, length)
