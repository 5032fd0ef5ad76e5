"""Three takes on disk: one that is annotated first, one that is added later, and one with a broken calibration."""

from dataclasses import dataclass
from pathlib import Path

import pytest
from tiny_recording import CHUNK_FRAMES, TinyRecording, detector_overrides, write_recording


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
