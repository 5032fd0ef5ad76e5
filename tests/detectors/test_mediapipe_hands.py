"""The search for a hand, with a stand-in for MediaPipe's model."""

import numpy as np
import pytest

from assemblyhands_core.detectors._mediapipe_hands import Look, Region, region_around, search_hand

IMAGE = np.zeros((100, 100, 3), dtype=np.uint8)
CENTER = np.array([50.0, 50.0])


def upright_hand(x: float = 50.0, y: float = 50.0, length: float = 20.0) -> np.ndarray:
    """A flat hand in MediaPipe's order: wrist below, five straight fingers side by side pointing up."""
    fingers = [(x + 2 * (f - 2), y - length * (1 + k) / 4) for f in range(5) for k in range(4)]
    return np.array([(x, y), *fingers])


class StandIn:
    """Sees what it is told, by the direction it looks in (degrees), and remembers the regions."""

    def __init__(self, looks: dict[int, Look], nothing: Look) -> None:
        self.looks, self.nothing, self.regions = looks, nothing, []

    def look(self, image_rgb: np.ndarray, region: Region) -> Look:
        self.regions.append(region)
        return self.looks.get(round(np.rad2deg(region.rotation_rad)) % 360, self.nothing)


def look(presence: float, label: str = "Left", at: tuple[float, float] = (50.0, 50.0)) -> Look:
    return Look(upright_hand(*at), label, 0.9, presence)


def test_a_region_around_an_upright_hand_is_twice_its_span_and_shifted_to_the_tips() -> None:
    # Without the tips the fingers end at y = 35 (three quarters of 20) and the wrist lies at y = 50;
    # sideways they span x = 46..54. So the span is 15, the middle (50, 42.5), the shift a tenth of 15.
    region = region_around(upright_hand())
    np.testing.assert_allclose(region, (50.0, 41.0, 30.0, 0.0), atol=1e-12)


@pytest.mark.parametrize("degrees", [90.0, -135.0])
def test_the_region_turns_with_the_hand(degrees: float) -> None:
    angle = np.deg2rad(degrees)
    clockwise = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = (upright_hand() - CENTER) @ clockwise.T + CENTER
    upright, region = region_around(upright_hand()), region_around(turned)
    np.testing.assert_allclose(region.rotation_rad, angle)
    np.testing.assert_allclose(region.side_px, upright.side_px)
    np.testing.assert_allclose(region[:2], clockwise @ (np.array(upright[:2]) - CENTER) + CENTER)


def test_the_surest_direction_wins() -> None:
    model = StandIn({0: look(0.2), 90: look(0.9), 180: look(0.3), 270: look(0.1)}, look(0.0))
    found = search_hand(model, IMAGE, "right", CENTER, 75.0, num_directions=4, num_refinements=0)
    assert found.presence == 0.9
    assert [round(np.rad2deg(r.rotation_rad)) for r in model.regions] == [0, 90, 180, 270]
    assert {(r.x_px, r.y_px, r.side_px) for r in model.regions} == {(50.0, 50.0, 75.0)}


@pytest.mark.parametrize(("hand", "label"), [("right", "Left"), ("left", "Right")])
def test_between_two_sure_hands_the_side_looked_for_wins(hand: str, label: str) -> None:
    # MediaPipe's labels are those of a mirrored picture.
    other = "Right" if label == "Left" else "Left"
    model = StandIn({0: look(0.9, other), 180: look(0.85, label)}, look(0.0))
    assert search_hand(model, IMAGE, hand, CENTER, 75.0, 2, 0).label == label


def test_between_two_equal_hands_the_one_in_the_middle_wins() -> None:
    model = StandIn({0: look(0.9, at=(95.0, 95.0)), 180: look(0.88)}, look(0.0))
    assert search_hand(model, IMAGE, "right", CENTER, 75.0, 2, 0).presence == 0.88
    model = StandIn({0: look(0.9, at=(95.0, 95.0)), 180: look(0.5)}, look(0.0))
    assert search_hand(model, IMAGE, "right", CENTER, 75.0, 2, 0).presence == 0.9


def test_refinement_looks_around_the_hand_found_and_stops_when_that_loses_it() -> None:
    # Looked at sideways (90°) the upright hand is found; its own region has no rotation.
    better = StandIn({90: look(0.6), 0: look(0.8)}, look(0.0))
    assert search_hand(better, IMAGE, "right", CENTER, 75.0, 4, 1).presence == 0.8
    np.testing.assert_allclose(better.regions[4], region_around(upright_hand()))
    worse = StandIn({90: look(0.9), 0: look(0.0)}, look(0.0))
    assert search_hand(worse, IMAGE, "right", CENTER, 75.0, 4, 2).presence == 0.9
