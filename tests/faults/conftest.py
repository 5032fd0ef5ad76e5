"""A recording, and what an undisturbed run makes of it."""

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import Outcome, digests, pipeline
from tiny_recording import TinyRecording, write_recording

sys.path.insert(0, str(Path(__file__).parent))  # for deadly_stages, which workers import


@dataclass(frozen=True)
class Undisturbed:
    """A recording, the workspace of a run that nothing disturbed, and its digests by node."""

    recording: TinyRecording
    workspace: Path
    digests: dict[str, str]

    @property
    def command(self) -> list[str]:
        """Return the command line that made it."""
        return ["annotate", *self.recording.overrides()]

    def assert_same(self, workspace: Path, outcome: Outcome) -> None:
        """Check that a command ended well, and that all tables of the newest run are those of the undisturbed one."""
        outcome.assert_done()
        assert digests(workspace) == self.digests
        assert _tables(workspace) == _tables(self.workspace)


def _tables(workspace: Path) -> dict[str, pa.Table]:
    """Return what the files of the newest run hold: the digests in its record only say what they should."""
    run = workspace / "runs" / "latest"
    files = {str(path.relative_to(run)): path.resolve() for path in sorted(run.glob("*/*/*.parquet"))}
    return {
        name: pq.ParquetFile(path, page_checksum_verification=True).read().replace_schema_metadata(None)
        for name, path in files.items()
    }


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    recording = write_recording(tmp_path_factory.mktemp("recording") / "tiny")
    workspace = tmp_path_factory.mktemp("undisturbed") / "work"
    found = Undisturbed(recording, workspace, {})
    pipeline(*found.command, "executor=serial", workspace=workspace).assert_done()
    return Undisturbed(recording, workspace, digests(workspace))


@pytest.fixture
def finished(undisturbed: Undisturbed, tmp_path: Path) -> Path:
    """A workspace in which everything is done, to damage."""
    shutil.copytree(undisturbed.workspace, tmp_path / "work", symlinks=True)
    return tmp_path / "work"


@pytest.fixture(scope="session")
def assert_clean() -> Callable[[Path], None]:
    """Check that nothing half-made can be seen in a workspace, and that gc removes what is hidden."""

    def check(workspace: Path) -> None:
        for entry in (workspace / "store").glob("[!.]*/[!.]*"):
            assert (entry / "record.json").is_file(), f"{entry} is no entry"
        for run in (workspace / "runs").glob("[!.]*"):
            assert (run / "run.json").is_file(), f"{run} is no run"
        pipeline("gc", workspace=workspace).assert_done()
        hidden = [path for folder in ("store", "runs") for path in (workspace / folder).rglob(".*") if any_file(path)]
        assert not hidden, f"gc left {hidden}"

    def any_file(path: Path) -> bool:
        return path.is_file() or any(path.iterdir())

    return check
