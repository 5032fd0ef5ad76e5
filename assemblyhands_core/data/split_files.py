"""Files that the recordings of a split have in common, written from what each recording brings.

The real data sets keep annotations in one file for a split. So that recordings can be made one at a time, each brings
its own share (`DatasetLayout.labels`) in the same forms, and the common files are written anew from all that are there.
"""

from collections.abc import Mapping
from dataclasses import replace

from assemblyhands_core.data.assemblyhands import (
    read_ego_calibration,
    read_joint_annotations,
    write_ego_calibration,
    write_joint_annotations,
)
from assemblyhands_core.data.assemblyhands_rig import write_skeleton
from assemblyhands_core.data.fine_grained import (
    Segment,
    read_fine_grained,
    write_actions,
    write_fine_grained_30fps,
    write_fine_grained_60fps,
)
from assemblyhands_core.data.layout import DatasetLayout, check_splits, read_split, write_splits

JOINTS_SHARE = "joint_3d.json"
EGO_SHARE = "ego_calib.json"
ACTIONS_SHARE = "fine_grained.csv"


def write_shared_files(layout: DatasetLayout, split_of: Mapping[str, str]) -> None:
    """Write the files of every split, with the recordings that were there before.

    Args:
        layout: Of the data set; every recording named here or in its split lists has its own share.
        split_of: Recordings → split; they leave the split that they were in before.

    Raises:
        ValueError: A person would occur in two splits.
        FormatError: A recording's share cannot be read.
    """
    splits = _with_new(layout, split_of)
    write_splits(layout, splits)
    segments = {split: _write_split(layout, split, sorted(names)) for split, names in splits.items()}
    actions = {s.action.action_id: s.action for found in segments.values() for s in found if s.action is not None}
    write_actions(layout.actions, actions.values())
    write_skeleton(layout.skeleton)


def check_new_splits(layout: DatasetLayout, split_of: Mapping[str, str]) -> None:
    """Check that recordings can be added to splits; for before they are made.

    Raises:
        ValueError: A person would occur in two splits, or a split has no name.
        FormatError: A list of recordings cannot be read.
    """
    check_splits(_with_new(layout, split_of))


def _with_new(layout: DatasetLayout, split_of: Mapping[str, str]) -> dict[str, set[str]]:
    """Return the recordings of every split, those that are there and the new ones."""
    files = sorted(layout.splits.glob("*.txt"))
    splits = {file.stem: {name for name in read_split(file) if layout.labels(name).is_dir()} for file in files}
    for recording, split in split_of.items():
        for names in splits.values():
            names.discard(recording)
        splits.setdefault(split, set()).add(recording)
    return splits


def _write_split(layout: DatasetLayout, split: str, recordings: list[str]) -> list[Segment]:
    """Write one split's files; return its segments."""
    folders = [layout.labels(name) for name in recordings]
    joints = {k: v for folder in folders for k, v in read_joint_annotations(folder / JOINTS_SHARE).items()}
    write_joint_annotations(layout.annotations(split, "joint_3d"), joints)
    worn = [folder / EGO_SHARE for folder in folders if (folder / EGO_SHARE).is_file()]
    if worn:
        ego = {k: v for file in worn for k, v in read_ego_calibration(file).items()}
        write_ego_calibration(layout.annotations(split, "ego_calib"), ego)
    else:
        layout.annotations(split, "ego_calib").unlink(missing_ok=True)
    segments = [s for folder in folders for s in read_fine_grained(folder / ACTIONS_SHARE).segments]
    write_fine_grained_60fps(layout.fine_grained(split, 60), [replace(s, views=()) for s in segments])
    write_fine_grained_30fps(layout.fine_grained(split, 30), segments)
    return segments
