"""What the simulator draws is what it drew: whoever changes it raises its version and stores the new numbers here."""

import numpy as np
import pytest

from assemblyhands_core.synthetic.crop_boxes import AroundHand
from assemblyhands_core.synthetic.crop_mode import CropStudio
from assemblyhands_core.synthetic.rig import assembly_rig
from assemblyhands_core.synthetic.take import Take
from assemblyhands_core.synthetic.version import SIMULATOR_VERSION

ADVICE = "the simulator draws something else: raise SIMULATOR_VERSION and store the new numbers"
VERSION = 2
JOINTS_MM = (
    (72.51, 60.44, 329.38),
    (128.97, 60.06, 340.34),
    (47.39, 157.18, 380.91),
)
GREYS = (
    (87.6, 137.7, 102.9, 91.4),
    (193.2, 151.0, 132.4, 150.4),
    (212.8, 123.3, 147.0, 206.4),
    (216.1, 179.3, 172.8, 189.7),
)


def test_the_simulator_draws_what_its_version_drew(take: Take) -> None:
    views = CropStudio.of(take, assembly_rig(1), 1, ["C10119_rgb"]).hand_views(3.0, "right", 64, AroundHand(2.0))
    joints = views.joints_world_mm[[0, 8, 20]]
    greys = views.images[0].mean(axis=-1).reshape(4, 16, 4, 16).mean(axis=(1, 3))
    assert SIMULATOR_VERSION == VERSION
    assert joints == pytest.approx(np.array(JOINTS_MM), abs=0.05), ADVICE
    assert greys == pytest.approx(np.array(GREYS), abs=1.5), ADVICE
