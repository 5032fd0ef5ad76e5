"""``fsck``: read the workspace again, say what is damaged, and set it aside so that the next run makes just that anew.

It removes nothing that is whole, and changes no table: what is damaged is moved to ``store/.damaged``.
"""

import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console

from assemblyhands_core.data.digests import FileDigests
from assemblyhands_core.data.integrity import Flaw
from assemblyhands_core.data.store import Store
from pipeline.byte_progress import ByteProgress
from pipeline.config import RunConfig
from pipeline.damage import Check, Damage, checks, find_damage, find_suspects
from pipeline.executors import num_cores
from pipeline.garbage import num_bytes_below, subfolders
from pipeline.run_folders import RunFolders, read_run_folders
from pipeline.takes import studio_folder
from pipeline.terminal import say


def fsck(config: RunConfig, console: Console) -> int:
    """Check a workspace; return 0 if it is whole, else 1. The caller holds the workspace's lock as a run does."""
    started = time.monotonic()
    runs, leftovers = read_run_folders(config.workspace), list(_leftovers(config.workspace))
    found = checks(Store(config.workspace), studio_folder(config.workspace))
    damages: list[Damage] = []
    try:
        for damage in _find(config, found, console):
            damages.append(damage)
    finally:  # who is interrupted after hours still hears what was found
        damages.sort(key=lambda damage: damage.place)
        sentences = _settle_all(damages, config, runs)
        for sentence in [*runs.flaws, *sentences, *leftovers]:
            say(console, sentence)
    num_bytes, seconds = sum(check.num_bytes for check in found), time.monotonic() - started
    rate = f"{num_bytes / 1e9:.2f} GB in {seconds:.1f} s, {num_bytes / 1e9 / seconds:.2f} GB/s"
    say(console, f"checked {len(found)} entries and recordings ({rate}): {_verdict(damages, runs)}")
    return 1 if damages or runs.flaws else 0


def _find(config: RunConfig, found: Sequence[Check], console: Console) -> Iterator[Damage]:
    num_threads = config.fsck.num_threads or num_cores()
    with ByteProgress(console, "checked", sum(check.num_bytes for check in found)) as progress:
        yield from find_damage(found, num_threads, progress.advance)


def _settle_all(damages: list[Damage], config: RunConfig, runs: RunFolders) -> list[str]:
    """Add what may have been made from damaged files, settle it all, and return the sentences.

    What is suspect is settled first: once its source is set aside, nobody would know.
    """
    damages += find_suspects(Store(config.workspace), damages)
    settled = [list(_settle(damage, config, runs)) for damage in reversed(damages)]
    return [sentence for sentences in reversed(settled) for sentence in sentences]


def _settle(damage: Damage, config: RunConfig, runs: RunFolders) -> Iterator[str]:
    """Set aside what is damaged, unless only a report is wanted; yield a sentence about each file."""
    remedy = _remedy(damage, runs)  # asked before: what is set aside is no longer where it was
    if damage.is_certain:
        done = "would be set aside" if config.fsck.dry_run else _set_aside(damage, config.workspace)
        remedy = f"{done}; {remedy}"
    yield from (f"{flaw.file}: {flaw.reason}; {remedy}" for flaw in damage.flaws)


def _remedy(damage: Damage, runs: RunFolders) -> str:
    if not damage.is_certain:
        return "see to it that it can be read, and check again"
    if damage.is_recording:
        return "the next run that needs this recording has it recorded again"
    command = runs.commands.get((damage.place.parent.name, damage.place.name))
    remedy = f"made anew by: {command}" if command else "no run refers to it, so nothing else is to be done"
    is_link = any(flaw.file.is_symlink() for flaw in damage.flaws)
    return f"restore the file that the link leads to, else it is taken as it is; {remedy}" if is_link else remedy


def _set_aside(damage: Damage, workspace: Path) -> str:
    try:
        for flaw in damage.flaws:
            _forget(flaw, workspace)
        if damage.is_recording:
            damage.place.unlink(missing_ok=True)  # without the list of its files, it counts as not recorded
        else:
            Store(workspace).set_aside(damage.place, "\n".join(f"{f.file.name}: {f.reason}" for f in damage.flaws))
    except OSError as error:
        return f"it could not be set aside ({error.strerror or error}), remove {damage.place} by hand"
    return "set aside"


def _forget(flaw: Flaw, workspace: Path) -> None:
    """Have a file from outside read again, though its size and time are what they were when it was read first."""
    if flaw.is_silent and flaw.file.is_symlink():
        FileDigests(workspace / "file-digests.json").forget(flaw.file)


def _leftovers(workspace: Path) -> Iterator[str]:
    """Yield sentences about what is no result: it does no harm but takes room."""
    hidden = list(Store(workspace).leftovers())
    aside = [path for path in hidden if path.parent.name == ".damaged"]
    drafts = [path for path in hidden if path not in aside and _is_left(path)]
    kinds = {
        "were set aside before (why stands in damaged.txt; gc removes them)": aside,
        "were left half-made by processes that are not on this machine now (gc removes them)": drafts,
        "are what long computations go on from (gc removes those that nobody needs)": subfolders(workspace / "scratch"),
    }
    for what, folders in kinds.items():
        if folders:
            num_bytes = sum(map(num_bytes_below, folders))
            yield f"{len(folders)} folders {what}: {num_bytes / 1e6:.1f} MB, such as {folders[0]}"


def _is_left(draft: Path) -> bool:
    """Whether the process is gone that was writing an entry."""
    try:
        os.kill(int(draft.name.split("-")[-2]), 0)
    except ProcessLookupError:
        return True
    except (PermissionError, ValueError, IndexError):
        pass  # somebody else's process, or no draft of ours
    return False


def _verdict(damages: Sequence[Damage], runs: RunFolders) -> str:
    if not damages and not runs.flaws:
        return "whole"
    num_aside = sum(damage.is_certain for damage in damages)
    return f"{num_aside} damaged, {len(damages) - num_aside} could not be read, {len(runs.flaws)} flaws in runs"
