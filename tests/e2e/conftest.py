"""Three takes on disk: one that is annotated first, one that is added later, and one with a broken calibration."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from command_line import Outcome, pipeline
from tiny_recording import CHUNK_FRAMES, TinyRecording, detector_overrides, write_recording

from assemblyhands_core.data.ground_truth import TrueInstant, ground_truth_tables, write_ground_truth


@dataclass(frozen=True)
class Studio:
    """Recordings in one folder, with manifests that name the first, and all of them."""

    folder: Path
    tiny: TinyRecording
    other: TinyRecording
    broken: TinyRecording

    def overrides(self, manifest: str, rounds: str = "0") -> list[str]:
        """Return what the command line takes to annotate a manifest's sequences from their 2D keypoints.

        The drawn recordings show no hands, so that rounds would find none.
        """
        return [
            f"rounds={rounds}",
            f"manifest={self.folder / manifest}",
            "seq=all",
            *detector_overrides(self.folder / "{sequence_id}"),
            f"ingest.chunk_frames={CHUNK_FRAMES}",
        ]


@pytest.fixture(scope="session")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Studio:
    folder = tmp_path_factory.mktemp("studio")
    recordings = [write_recording(folder / name, seed) for seed, name in enumerate(("tiny", "other", "broken"))]
    broken = recordings[2].calibration
    broken.write_text(broken.read_text().replace('"fx": 260.0', '"fx": NaN', 1))
    for manifest, names in (("one.csv", ["tiny"]), ("all.csv", ["tiny", "other", "broken"])):
        rows = [f"{name},test,{name}/calibration.json,{name}/videos/*.mp4," for name in names]
        (folder / manifest).write_text("\n".join(["sequence_id,split,calibration,videos,package", *rows]) + "\n")
    return Studio(folder, *recordings)


@dataclass(frozen=True)
class Judged:
    """A recording whose truth the pipeline knows, annotated and evaluated in a workspace.

    Attributes:
        overrides: what the command line took.
        outcome: what the command said.
    """

    workspace: Path
    tiny: TinyRecording
    overrides: tuple[str, ...]
    outcome: Outcome


@pytest.fixture(scope="session")
def judged(tmp_path_factory: pytest.TempPathFactory) -> Judged:
    folder = tmp_path_factory.mktemp("judged")
    tiny = write_recording(folder / "tiny")
    is_seen = {name: np.ones((2, 21), dtype=bool) for name in tiny.cameras}
    instants = [TrueInstant(frame, joints, tiny.cameras, is_seen) for frame, joints in enumerate(tiny.joints_mm)]
    write_ground_truth(folder / "truth", ground_truth_tables("tiny", instants))
    columns = "sequence_id,split,calibration,videos,package,ground_truth"
    (folder / "set.csv").write_text(f"{columns}\ntiny,test,tiny/calibration.json,tiny/videos/*.mp4,,truth\n")
    overrides = (
        "rounds=0",
        f"manifest={folder / 'set.csv'}",
        "seq=tiny",
        *detector_overrides(tiny.folder),
        f"ingest.chunk_frames={CHUNK_FRAMES}",
    )
    workspace = folder / "work"
    outcome = pipeline("annotate", "executor=serial", "run=judged", *overrides, workspace=workspace)
    return Judged(workspace, tiny, overrides, outcome.assert_done())
