"""Which hands a run's report shows from round to round, and what each round made of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.data.hand_crops import HandKey, stored_hands
from assemblyhands_core.data.round_outcomes import displacement_mm
from assemblyhands_core.data.rounds import WindowRule, joints_or_nan, known_hands
from assemblyhands_core.viz.round_sheet import HandCourse, HandRound, choose_hands, follow_hand

MAX_HANDS: Final = 4
HAND_KEY: Final = ("sequence_id", "frame", "hand")
"""The columns that a hand at an instant is known by."""


class _Place(NamedTuple):
    """Where a hand is: in which shard's file."""

    file: str
    key: HandKey


def read_courses(run: Path, rule: WindowRule, max_hands: int = MAX_HANDS) -> list[HandCourse]:
    """Return the hands that moved farthest from the first round to the last, spread over time.

    Args:
        run: Folder of a run.
        rule: How its rounds chose their windows.
        max_hands: How many hands at most.

    Returns:
        Nothing where there are no two rounds, or no crops.
    """
    rounds = round_nodes(run)
    if len(rounds) < 2:
        return []
    places: list[_Place] = []
    moved_mm: list[np.ndarray] = []
    for file in _whole_shards(run, rounds):
        first, last = (_read(node / "joints" / file) for node in (rounds[0], rounds[-1]))
        places += [_Place(file, key) for key in _keys(last)]
        moved_mm.append(displacement_mm(joints_or_nan(last), joints_or_nan(first)))
    chosen = choose_hands([place.key for place in places], np.concatenate([np.empty(0), *moved_mm]), max_hands)
    courses = (_course(run, rounds, places[index], rule) for index in chosen)
    return [course for course in courses if course is not None]


def follow_hands(run: Path, rule: WindowRule, keys: Sequence[HandKey]) -> list[HandCourse]:
    """Return what the rounds made of these hands, in their order; those without crop or a round are left out.

    Args:
        run: Folder of a run.
        rule: How its rounds chose their windows.
        keys: Which hands.
    """
    rounds = round_nodes(run)
    if not rounds:
        return []
    wanted = set(keys)
    places: dict[HandKey, _Place] = {}
    for file in _whole_shards(run, rounds):
        found = wanted.intersection(_keys(_read(rounds[-1] / "joints" / file, list(HAND_KEY))))
        places |= {key: _Place(file, key) for key in found}
    courses = (_course(run, rounds, places[key], rule) for key in keys if key in places)
    return [course for course in courses if course is not None]


def round_nodes(run: Path) -> list[Path]:
    """Return the folders of a run's rounds, from round 0 on."""
    return sorted(run.glob("round_*"), key=lambda node: int(node.name.removeprefix("round_")))


def round_label(node: Path) -> str:
    """Return what readers call a round's node."""
    number = int(node.name.removeprefix("round_"))
    return f"R{number}" if number else "2D + triangulation"


def _whole_shards(run: Path, rounds: Sequence[Path]) -> list[str]:
    """Return the names of the files that every round and its inputs have: what failed is left out."""
    tables = [*(node / "joints" for node in rounds), run / "crop_hands" / "crops", run / "detect_hands" / "hand_boxes"]
    return sorted(set.intersection(*({path.name for path in table.glob("*.parquet")} for table in tables)))


def _course(run: Path, rounds: Sequence[Path], place: _Place, rule: WindowRule) -> HandCourse | None:
    """Return what the rounds made of a hand; nothing if it has no crop."""
    stored = stored_hands(_of_hand(run / "crop_hands" / "crops" / place.file, place.key)).get(place.key)
    if stored is None:
        return None
    boxes = _of_hand(run / "detect_hands" / "hand_boxes" / place.file, place.key)
    views = _read(run / "undistort" / "rectified_views" / f"{place.key[0]}.parquet")
    matrices = {name: camera.P_pixel_from_world for name, camera in valid_cameras(views).items()}
    steps = []
    for number, node in enumerate(rounds):
        (known,) = known_hands(_of_hand(node / "joints" / place.file, place.key), boxes)
        (row,) = _of_hand(node / "rounds" / place.file, place.key).to_pylist() if number else ({},)
        steps.append(HandRound(known, row.get("kept_round", 0), row.get("reason", "")))
    return follow_hand(steps, stored, matrices, rule)


def _of_hand(path: Path, key: HandKey) -> pa.Table:
    """Return the rows of one hand at one instant; pictures of the others are not kept."""
    _, frame, hand = key
    is_hand = (pc.field("frame") == frame) & (pc.field("hand") == hand)
    return pq.read_table(path.resolve(), filters=is_hand).replace_schema_metadata(None)


def _read(path: Path, columns: list[str] | None = None) -> pa.Table:
    return pq.read_table(path.resolve(), columns=columns).replace_schema_metadata(None)


def _keys(joints: pa.Table) -> list[HandKey]:
    return list(zip(*(joints[name].to_pylist() for name in HAND_KEY), strict=True))
