"""Put a run's page together and write it."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from rich.console import Console

from pipeline.finished import FinishedRun
from pipeline.html_report import annotation, instants, joints, making, networks, overview, rounds
from pipeline.html_report.page import Page, Section

FILE: Final = "report.html"
_SECTIONS: Final[tuple[Callable[[FinishedRun], Section], ...]] = (
    overview.summary,
    annotation.annotation,
    joints.joints,
    annotation.sequences,
    rounds.reprojection,
    rounds.displacement,
    instants.instants,
    instants.drawn,
    networks.egocentric,
    networks.verbs,
    making.quality,
    making.times,
    making.provenance,
)


def write_page(console: Console, run: FinishedRun) -> Path:
    """Write a run's ``report/report.html``, say where it is, and return its path."""
    folder = run.folder / "report"
    folder.mkdir(exist_ok=True)
    return save(console, run_page(run), folder / FILE)


def run_page(run: FinishedRun) -> Page:
    """Return the page of a run; a part that the run has nothing for says so in a sentence."""
    command, ended, commit = (run.record.get(name, "unknown") for name in ("command", "time", "commit"))
    lead = f"Command: `{command}`. Ended: {ended}. Commit: {commit}."
    return Page(f"Run {run.name}", lead, [section(run) for section in _SECTIONS])


def save(console: Console, page: Page, path: Path) -> Path:
    """Write a page whole, and say where it is."""
    draft = path.with_name(f".{path.name}")
    draft.write_text(page.render(), encoding="utf-8")
    draft.replace(path)
    console.print(f"report: {path}", markup=False, highlight=False, soft_wrap=True)
    return path
