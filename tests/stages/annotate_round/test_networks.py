"""A tiny network that knows nothing: batches, weights and empty tables."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import torch
from round_scene import CONFIG, GUARD, KEYS, TINY, KnownAnswer, Scene, joints_table, points_of, truth_moved

from assemblyhands_core.data.arrays import to_numpy
from assemblyhands_core.data.catalog import JOINTS
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.models.mvexonet import MVExoNet
from assemblyhands_core.models.pretrained import save_weights
from stages._contract import Context
from stages.annotate_round import STAGE


@pytest.fixture(scope="module")
def tiny() -> MVExoNet:
    torch.manual_seed(0)
    return MVExoNet(TINY).eval()


def with_trust(how: Mapping[str, Any]) -> dict[str, Any]:
    """Believe whatever an untrained network says."""
    wide = dict.fromkeys(("max_displacement_mm", "max_body_distance_mm", "max_size", "max_bone_mm"), 1e4)
    guard = GUARD.model_copy(update={**wide, "min_size": 0.0, "min_reprojection_px": 1e4})
    return {"guard": guard, "min_confidence": 0.0, **how}


def test_batches_do_not_matter_and_equal_runs_are_equal(run: Any, scene: Scene, tiny: MVExoNet) -> None:
    crops = scene.inputs["crops"]
    without = [not (row["frame"] == 4 and row["camera_id"] in "ab") for row in crops.to_pylist()]
    inputs = {"crops": crops.filter(pa.array(without))}
    together, again = (run(tiny, inputs, **with_trust({})) for _ in range(2))
    assert str(together) == str(again)  # NaN is not itself
    alone = run(tiny, inputs, **with_trust({"batch_size": 1}))
    for one, other in zip(together["joints"], alone["joints"], strict=True):
        assert all(one["valid"]) and np.ptp(points_of(one), axis=0).max() > 1e-2
        np.testing.assert_allclose(points_of(one), points_of(other), atol=1e-3)
    turned = run(tiny, inputs | {"joints": joints_table().take([3, 0, 2])}, **with_trust({}))["joints"]
    assert [(row["frame"], row["hand"]) for row in turned] == [KEYS[3], KEYS[0], KEYS[2]]
    np.testing.assert_allclose(points_of(turned[1]), points_of(together["joints"][0]), atol=1e-3)


def test_weights_come_from_the_file_of_the_config(scene: Scene, tiny: MVExoNet, tmp_path: Path) -> None:
    path = tmp_path / "tiny.safetensors"
    save_weights(path, tiny, {})
    config = CONFIG.model_copy(update=with_trust({"weights": str(path)}))
    tables = STAGE.run(config, scene.inputs, Context(tmp_path, "s"))
    assert to_numpy(tables["joints"]["valid"]).all() and tables["rounds"].num_rows == 4
    assert STAGE.externals(config, "s") == {"weights": digest_file(path)}
    with pytest.raises(ValueError, match=r"no weights at .*/nowhere\.safetensors: run `make train`"):
        STAGE.externals(config.model_copy(update={"weights": "nowhere.safetensors"}), "s")


def test_no_rows_give_empty_tables(run: Any) -> None:
    assert run(KnownAnswer(truth_moved()), {"joints": JOINTS.empty()}) == {"joints": [], "rounds": []}
