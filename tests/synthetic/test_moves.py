"""The verbs as motion: what is taken is carried, what is put somewhere lies there exactly."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from assemblyhands_core.geometry import transforms
from assemblyhands_core.synthetic.bench import Bench
from assemblyhands_core.synthetic.motion import WORLD
from assemblyhands_core.synthetic.moves import pick_up, position, put_down, remove
from assemblyhands_core.synthetic.rig import TABLE_TOP_Y_MM


def first(bench: Bench, noun: str, is_mounted: bool) -> str:
    fits = (n for n, p in bench.parts.parts.items() if p.noun == noun and (n in bench.mounted) == is_mounted)
    return next(n for n in fits if not bench.mounted_children(n) or not is_mounted)


def test_picking_up_lifts_the_part_and_keeps_it_in_the_hand(bench: Bench) -> None:
    name = first(bench, "wheel", is_mounted=False)
    before = bench.at(0.0).T_world_from(name)
    end_s = pick_up(bench, bench.worker, name, 0.2)
    assert bench.held[bench.worker].part == name and not bench.is_on_table(name)
    assert bench.at(end_s).T_world_from(name)[1, 3] > before[1, 3] + 40.0
    taken_s = bench.part_keys[name][-1].t_s
    in_hand = [
        transforms.inverse(bench.at(t).T_world_from(bench.worker)) @ bench.at(t).T_world_from(name)
        for t in (taken_s, 0.5 * (taken_s + end_s), end_s)
    ]
    assert_allclose(in_hand[1], in_hand[0], atol=1e-9)
    assert_allclose(in_hand[2], in_hand[0], atol=1e-9)
    assert_allclose(bench.at(taken_s).T_world_from(name), before, atol=1e-6)
    segment = bench.segments[-1]
    assert (segment.verb, segment.noun, segment.hand) == ("pick up", "wheel", bench.worker)
    assert 0.2 < segment.start_s < taken_s < segment.end_s == end_s


def test_what_is_put_down_rests_on_the_table_and_the_hand_is_free(bench: Bench) -> None:
    name = first(bench, "wheel", is_mounted=False)
    t_s = put_down(bench, bench.worker, pick_up(bench, bench.worker, name, 0.2))
    carrier, pose = bench.tracks.parts[name].at(t_s)
    assert carrier == WORLD and bench.worker not in bench.held and bench.is_on_table(name)
    lowest = transforms.apply(pose, bench.part(name).vertices_mm)[:, 1].min()
    assert lowest == pytest.approx(TABLE_TOP_Y_MM, abs=1e-6)
    put_s = bench.part_keys[name][-1].t_s
    assert_allclose(bench.at(put_s - 1e-6).T_world_from(name), pose, atol=1e-3)
    assert bench.segments[-1].verb == "put down" and bench.segments[-1].end_s <= t_s


def test_a_positioned_part_is_exactly_on_its_mount_while_the_toy_is_held(bench: Bench) -> None:
    name = first(bench, "wheel", is_mounted=False)
    t_s = position(bench, pick_up(bench, bench.worker, name, 0.2))
    now = bench.at(t_s)
    mounted = transforms.inverse(now.T_world_from("chassis")) @ now.T_world_from(name)
    wanted = bench.parts.T_root_from_part(name)
    assert_allclose(mounted[:3, 3], wanted[:3, 3], atol=1e-9)
    assert_allclose(mounted[:3, 2], wanted[:3, 2], atol=1e-9)
    assert bench.is_loose(name) and bench.held[bench.holder].part == "chassis"
    put_s = bench.part_keys[name][-1].t_s
    assert_allclose(bench.at(put_s - 1e-6).T_world_from(name), bench.at(put_s).T_world_from(name), atol=1e-3)


def test_removing_pulls_a_part_off_along_its_axis(built_bench: Bench) -> None:
    bench = built_bench
    name = next(n for n in ("bumper", "cabin") if n in bench.mounted and not bench.mounted_children(n))
    outwards = bench.at(0.0).T_world_from(name)[:3, 2]
    t_s = remove(bench, name, 0.2)
    assert name not in bench.mounted and bench.held[bench.worker].part == name
    pulled = transforms.inverse(bench.at(t_s).T_world_from("chassis")) @ bench.at(t_s).T_world_from(name)
    assert np.linalg.norm(pulled[:3, 3] - bench.parts.T_root_from_part(name)[:3, 3]) > 30.0
    assert np.linalg.norm(outwards) == pytest.approx(1.0)
    segment = bench.segments[-1]
    during = bench.at(segment.end_s)
    along = transforms.inverse(during.T_world_from("chassis")) @ during.T_world_from(name)
    offset = along[:3, 3] - bench.parts.T_root_from_part(name)[:3, 3]
    assert_allclose(offset / np.linalg.norm(offset), bench.parts.T_root_from_part(name)[:3, 2], atol=0.1)


def test_a_part_without_a_mount_cannot_be_positioned(bench: Bench) -> None:
    t_s = pick_up(bench, bench.worker, "screwdriver", 0.2)
    with pytest.raises(ValueError, match="screwdriver has no mount"):
        position(bench, t_s)
