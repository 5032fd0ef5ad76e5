"""``python -m pipeline correct``: what a person changed in a task becomes part of a sequence's corrections."""

from collections import defaultdict
from pathlib import Path

from rich.console import Console

from assemblyhands_core.data.coco_keypoints import read_coco_keypoints
from assemblyhands_core.data.correction_file import Correction, read_corrections, write_corrections
from assemblyhands_core.data.correction_tasks import TaskPicture, changes
from assemblyhands_core.data.corrections import NOT_SEEN
from assemblyhands_core.data.json_files import FormatError
from pipeline.config import RunConfig, UserError
from pipeline.correction_folders import read_task, task_folder
from pipeline.terminal import say


def import_corrections(config: RunConfig, console: Console) -> int:
    """Add what was changed in the file ``corrected`` to the corrections of its sequences; return the exit code.

    Raises:
        UserError: It is not as it should be, or of no task; nothing is imported then.
    """
    if config.corrected is None or config.corrections is None:
        raise UserError("name the COCO keypoints file that the annotation tool has written: corrected=PATH")
    try:
        found = _changes(config.corrected, config.corrections.absolute())
        for sequence_id, changed in found.items():
            path = config.corrections.absolute() / f"{sequence_id}.csv"
            before = {c.key: c for c in read_corrections(path)} if path.is_file() else {}
            write_corrections(path, {**before, **{c.key: c for c in changed}}.values())
            say(console, f"{_said(sequence_id, changed)}: {path}")
    except FormatError as error:
        raise UserError(str(error)) from error
    if not any(found.values()):
        say(console, "nothing was changed in these pictures")
    return 0


def _changes(corrected: Path, corrections: Path) -> dict[str, list[Correction]]:
    """Return what a file changes, by sequence."""
    returned = read_coco_keypoints(corrected)
    pictures: dict[str, TaskPicture] = {}
    for folder in {task_folder(corrections, picture.file_name) for picture in returned}:
        pictures |= read_task(folder)
    found: dict[str, list[Correction]] = defaultdict(list)
    for correction in changes(pictures, returned, str(corrected)):
        found[correction.sequence_id].append(correction)
    return found


def _said(sequence_id: str, changed: list[Correction]) -> str:
    hands = {(correction.frame, correction.hand) for correction in changed}
    unseen = sum(correction.visibility == NOT_SEEN for correction in changed)
    parts = f"{len(changed) - unseen} points set" + (f", {unseen} marked as not seen" if unseen else "")
    return f"{sequence_id}: {parts}, of {len(hands)} hands; runs of it use them from now on"
