"""A round of annotation of two hands, with any network."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from round_scene import CONFIG, Scene, boxes_table, crops_table, joints_table, keypoints_table

from assemblyhands_core.data.camera_rows import valid_cameras
from assemblyhands_core.models.mvexonet import MVExoNet
from stages._contract import Context
from stages.annotate_round import STAGE


@pytest.fixture
def scene(world: Any) -> Scene:
    torch.set_num_threads(1)
    views = world.views()
    rectified_views = world.rectified(views)
    rectified = valid_cameras(rectified_views)
    inputs = {
        "views": views,
        "rectified_views": rectified_views,
        "hand_boxes": boxes_table(rectified),
        "crops": crops_table(rectified),
        "keypoints": keypoints_table(world.cameras),
        "joints": joints_table(),
        "triangulated": joints_table(),
        "earlier_joints": joints_table(),
    }
    return Scene(world, inputs)


@pytest.fixture
def run(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[..., dict[str, list[dict[str, Any]]]]:
    """Return the stage, run with a network and some of its inputs and parameters replaced."""
    weights = tmp_path / "weights.safetensors"
    weights.write_bytes(b"")  # which loading would read

    def run_stage(network: MVExoNet, inputs: Any = None, **how: Any) -> dict[str, list[dict[str, Any]]]:
        monkeypatch.setattr("assemblyhands_core.models.pretrained.load_mvexonet", lambda path: network)
        tables = STAGE.run(
            CONFIG.model_copy(update={"weights": str(weights), **how}),
            scene.inputs | (inputs or {}),
            Context(Path(), "s"),
        )
        return {name: table.to_pylist() for name, table in tables.items()}

    return run_stage
