"""Screwing and unscrewing: opposite senses, travel along the thread, the tool turns with the screw."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assemblyhands_core.geometry import transforms
from assemblyhands_core.synthetic.bench import Bench
from assemblyhands_core.synthetic.motion import rotation_vector
from assemblyhands_core.synthetic.moves import pick_up
from assemblyhands_core.synthetic.turning import turn_screw


def a_screw(bench: Bench, is_tight: bool) -> str:
    """Return a mounted screw, turned in or not, whatever the draw has made of it."""
    name = next(n for n in bench.mounted if bench.part(n).noun == "screw")
    out = 0.0 if is_tight else bench.part(name).mount.travel_mm
    bench.mounted[name] = (0.0, out)
    bench.part_keys[name].clear()
    bench.carry(name, bench.part(name).mount.parent, bench.T_parent_from_mounted(name, 0.0, out), 0.0)
    return name


def turned_rad(bench: Bench, name: str, frame: str, start_s: float, end_s: float, only_with_screw: bool) -> float:
    """How far something turns about the screw's outward axis, summed over small steps in the screw's parent."""
    total, parent = 0.0, bench.part(name).mount.parent
    times = np.arange(start_s, end_s, 0.02)
    for before, after in itertools.pairwise(times):
        a, b = bench.at(before), bench.at(after)
        a_in, b_in = (transforms.inverse(i.T_world_from(parent)) @ i.T_world_from(frame) for i in (a, b))
        screw = [bench.tracks.parts[name].at(t)[1] for t in (before, after)]
        step = (b_in[:3, :3] @ a_in[:3, :3].T, screw[1][:3, :3] @ screw[0][:3, :3].T)
        if not only_with_screw or np.linalg.norm(rotation_vector(step[1])) > 1e-6:
            total += rotation_vector(step[0]) @ screw[0][:3, 2]
    return float(total)


@pytest.mark.parametrize("by_tool", [False, True])
@pytest.mark.parametrize("is_tight", [False, True])
def test_clockwise_is_in_and_the_hand_turns_with_the_screw(built_bench: Bench, is_tight: bool, by_tool: bool) -> None:
    bench, strokes = built_bench, 3
    name = a_screw(bench, is_tight)
    t_s = pick_up(bench, bench.worker, "screwdriver", 0.1) if by_tool else 0.1
    turn_screw(bench, name, t_s, strokes)
    segment = bench.segments[-1]
    sense = 1.0 if is_tight else -1.0
    assert segment.verb == ("unscrew" if is_tight else "screw")
    screw = turned_rad(bench, name, name, t_s, segment.end_s, only_with_screw=False)
    assert strokes * 0.9 < sense * screw < strokes * 2.0
    hand = turned_rad(bench, name, bench.worker, t_s, segment.end_s, only_with_screw=True)
    assert hand == pytest.approx(screw, rel=0.05)
    assert bench.is_tight(name) == (not is_tight)


def test_the_screw_goes_in_by_its_travel(built_bench: Bench) -> None:
    name = a_screw(built_bench, is_tight=False)
    turn_screw(built_bench, name, 0.1, 2)
    keys = built_bench.part_keys[name]
    way = keys[0].T_carrier_from_part[:3, 3] - keys[-1].T_carrier_from_part[:3, 3]
    assert_allclose(way, built_bench.part(name).mount.travel_mm * keys[0].T_carrier_from_part[:3, 2], atol=1e-9)


def test_the_tip_of_the_tool_stays_in_the_head_and_the_tool_goes_back_into_the_hand(built_bench: Bench) -> None:
    bench = built_bench
    name = a_screw(bench, is_tight=True)
    end_s = turn_screw(bench, name, pick_up(bench, bench.worker, "screwdriver", 0.1), 3)
    segment = bench.segments[-1]
    turns = [key.t_s for key in bench.part_keys[name][1:]]
    for t_s in np.linspace(turns[0], turns[-1], 25):
        now = bench.at(float(t_s))
        tip = transforms.inverse(now.T_world_from(name)) @ now.T_world_from("screwdriver")
        assert_allclose(tip[:3, 3], [0.0, 0.0, bench.part(name).vertices_mm[:, 2].max() - 2.0], atol=1e-6)
        assert_allclose(tip[:3, 2], [0.0, 0.0, 1.0], atol=1e-9)
    assert bench.carrier("screwdriver") == bench.worker and segment.end_s <= end_s
    before, after = bench.at(turns[-1] - 1e-6), bench.at(turns[-1] + 1e-6)
    assert_allclose(before.T_world_from("screwdriver"), after.T_world_from("screwdriver"), atol=1e-3)


def test_fingers_let_go_on_the_way_back(built_bench: Bench) -> None:
    bench = built_bench
    name = a_screw(bench, is_tight=False)
    turn_screw(bench, name, 0.1, 3)
    segment = bench.segments[-1]
    middle_s = 0.5 * (segment.start_s + segment.end_s)
    bends = [bench.at(float(t_s)).angles_rad(bench.worker)[5] for t_s in np.arange(middle_s, segment.end_s, 0.03)]
    assert np.ptp(bends) > np.radians(4.0)  # flexion of the index finger's base
