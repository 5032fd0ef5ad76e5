"""What the command line's verbs do."""

import itertools
import time
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich.console import Console

from assemblyhands_core.data.digests import FileDigests
from assemblyhands_core.data.locks import locked
from assemblyhands_core.data.members import judged_sequences
from assemblyhands_core.data.store import Store
from pipeline import summary
from pipeline.comparison import compare_runs
from pipeline.config import RunConfig, UserError
from pipeline.correcting import import_corrections
from pipeline.disk_space import check_space, space_sentence
from pipeline.ego_evaluation import print_egocentric
from pipeline.evaluation import kinds_of_sequences, print_evaluation
from pipeline.executors import open_executor, resolve_workers
from pipeline.exporting import write_export, write_hands2023
from pipeline.garbage import find_garbage
from pipeline.graph import JUDGED_EDGE
from pipeline.history import History
from pipeline.integrity import fsck
from pipeline.interrupts import interrupts_kept
from pipeline.plan import make_plan, total_seconds
from pipeline.preflight import preflight
from pipeline.progress import Progress
from pipeline.publishing import publish
from pipeline.recordings import select_recordings, synthetic_sequences
from pipeline.report import report_again, write_report
from pipeline.rerun_view import write_rerun_views
from pipeline.runner import Runner, results
from pipeline.suspects import write_suspects
from pipeline.takes import absent_takes, select_takes, studio_folder
from pipeline.tasks import Result
from pipeline.terminal import say, terminal
from pipeline.verb_evaluation import print_verbs
from pipeline.view import LATEST, write_view
from pipeline.work import SequenceWork, member_rows, possible_nodes, with_set

_MAX_REPAIRS = 20  # each round finds what is damaged one node further
_READING = {  # what is there
    "fsck": fsck,
    "report": report_again,
    "compare": compare_runs,
    "view": write_rerun_views,
    "suspects": write_suspects,
    "correct": import_corrections,
}


def execute(command: str, config: RunConfig, command_line: str) -> int:
    """Carry out one command; return the exit code."""
    console = terminal()
    config = config.model_copy(update={"workspace": config.workspace.absolute()})
    if command == "plan":
        return _plan(config, console)
    if command == "preflight":
        return preflight(config, console)
    if command == "gc":
        return _collect_garbage(config, console)
    if command in _READING:
        with _lock(config.workspace, exclusive=False):
            return _READING[command](config, console)
    if config.run == LATEST:
        raise UserError(f"run={LATEST} cannot name a new run: it is the link to the newest one; give it another name")
    if (before := _recording_first(config)) is not None:
        say(console, f"these sequences are recorded first, once, in the simulated studio: {before.seq}")
        if code := _run(before, console, command_line):
            return code
    return _run(config, console, command_line)


def _recording_first(config: RunConfig) -> RunConfig | None:
    """Return the run that records what this one needs and what is not there yet, None if all is."""
    absent = [] if config.starts_in_studio else absent_takes(config)
    return config.model_copy(update={"target": "simulate", "seq": ",".join(absent), "run": ""}) if absent else None


def _plan(config: RunConfig, console: Console) -> int:
    if (before := _recording_first(config)) is not None:
        say(console, f"the studio has to record first, the rest is known then: {before.seq}")
        config = before
    works = _works(config, "plan")
    rows = make_plan(works, Store(config.workspace), History(config.workspace), is_only_told=True)
    summary.print_plan(console, rows, total_seconds(rows, resolve_workers(config.executor)[0]))
    if any(row.num_bytes for row in rows):
        say(console, space_sentence(config.workspace, rows))
    return 0


def _run(config: RunConfig, console: Console, command_line: str) -> int:
    started = time.monotonic()
    run = config.run or _new_run_name(config.workspace)
    with _lock(config.workspace, exclusive=False):
        found = _run_until_whole(config, run, console)
        folder = write_view(config, run, found, command_line)
        if config.starts_in_studio:
            root = studio_folder(config.workspace)
            for name in publish(config, found, root):
                say(console, f"recorded: {name} in {root}")
    summary.print_unmade(console, config, found)
    summary.print_audit(console, folder)
    summary.print_left_out(console, folder)
    summary.print_quality(console, folder)
    summary.print_rounds(console, folder, synthetic_sequences(config))
    summary.print_weights(console, folder)
    kinds = kinds_of_sequences(config)
    print_evaluation(console, config, folder, kinds)
    print_egocentric(console, folder)
    print_verbs(console, folder)
    write_report(console, config, folder, kinds)
    write_export(console, config, folder)
    write_hands2023(console, config, folder)
    summary.print_keypoints(console, folder)
    summary.print_corrections(console, folder)
    summary.print_times(console, found, started)
    say(console, f"results: {folder}")
    if all(result.has_entry for result in found):
        return 0
    summary.print_failures(console, found, _logs(config, run))
    return 1


def _run_until_whole(config: RunConfig, run: str, console: Console) -> list[Result]:
    """Run; again where a damaged entry of the store was found and set aside meanwhile."""
    for _ in range(_MAX_REPAIRS):
        works = _works(config, run)
        rows = make_plan(works, Store(config.workspace), History(config.workspace))
        if any(row.num_to_run != 0 for row in rows):
            if config.check_space:
                check_space(config.workspace, rows)
            _execute(config, works, console)
        if not any(result.is_repairable for result in results(works)):
            break
        say(console, "entries of the store were damaged, and set aside, or have vanished; they are made anew")
    return results(works)


def _execute(config: RunConfig, works: list[SequenceWork], console: Console) -> None:
    """Run what the plan has not settled."""
    with (
        interrupts_kept(),
        open_executor(config.executor, config.workspace, uuid.uuid4().hex[:8]) as executor,
        Progress(console) as progress,
    ):
        Runner(works, executor, Store(config.workspace), progress).run()


def _collect_garbage(config: RunConfig, console: Console) -> int:
    with _lock(config.workspace, exclusive=True):
        garbage = find_garbage(config.workspace, config.gc)
        counts = f"{len(garbage.runs)} runs, {len(garbage.entries)} entries, {len(garbage.leftovers)} leftovers"
        counts += f", scratch of {len(garbage.scratch)} computations"
        verb = "would remove" if config.gc.dry_run else "removed"
        say(console, f"{verb} {counts}: {garbage.num_bytes / 1e6:.1f} MB")
        if not config.gc.dry_run:
            garbage.remove()
    return 0


def _works(config: RunConfig, run: str) -> list[SequenceWork]:
    digests = FileDigests(config.workspace / "file-digests.json")
    threads = resolve_workers(config.executor)[1]
    sequences = select_takes(config) if config.starts_in_studio else select_recordings(config)
    split_of = {sequence.sequence_id: sequence.split for sequence in sequences}
    judged, works = judged_sequences(split_of), []
    for sequence in sequences:
        origins = {**sequence.origin_rows(digests), JUDGED_EDGE: member_rows(split_of, judged & {sequence.sequence_id})}
        nodes = possible_nodes(config, sequence.sequence_id, origins)
        works.append(SequenceWork(config, sequence, origins, nodes, _logs(config, run), threads))
    return with_set(works, split_of)


def _new_run_name(workspace: Path) -> str:
    """Return the time as a name that no other run has, nor takes meanwhile: its log folder is made here."""
    now = time.strftime("%Y%m%d-%H%M%S")
    for name in itertools.chain([now], (f"{now}-{n}" for n in itertools.count(2))):
        try:
            (workspace / "logs" / name).mkdir(parents=True)
        except FileExistsError:
            continue
        return name
    raise AssertionError("itertools.count does not end")


def _logs(config: RunConfig, run: str) -> Path:
    return config.workspace / "logs" / run


@contextmanager
def _lock(workspace: Path, *, exclusive: bool) -> Iterator[None]:
    """Hold the workspace: any number of runs and ``fsck`` at once, or one ``gc``. The lock falls with the process."""
    workspace.mkdir(parents=True, exist_ok=True)
    with ExitStack() as held:
        try:
            held.enter_context(locked(workspace / ".lock", exclusive=exclusive))
        except BlockingIOError:  # of the lock alone: a machine without room for more processes says the same
            other = f"a run is at work in {workspace} (or fsck)" if exclusive else f"gc is at work in {workspace}"
            raise UserError(f"{other}; try again when it has ended") from None
        yield
