"""The sets of things: closed, resting on the table, fitting one another, different by seed."""

from typing import get_args

import numpy as np
import pytest

from assemblyhands_core.geometry import transforms
from assemblyhands_core.synthetic.objects import PartSet
from assemblyhands_core.synthetic.toys import NOUNS, SetKind, draw_set, toy_name

SETS = [(kind, draw_set(kind, np.random.default_rng(seed))) for kind in get_args(SetKind) for seed in range(4)]


@pytest.mark.parametrize(("kind", "parts"), SETS)
def test_all_parts_are_closed(kind: SetKind, parts: PartSet) -> None:
    for part in parts.parts.values():
        edges = np.concatenate([part.faces[:, [i, (i + 1) % 3]] for i in range(3)])
        assert {tuple(edge) for edge in edges} == {tuple(edge[::-1]) for edge in edges}, part.name
        assert len(np.unique(edges, axis=0)) == len(edges)


@pytest.mark.parametrize(("kind", "parts"), SETS)
def test_parts_rest_on_the_table(kind: SetKind, parts: PartSet) -> None:
    for part in parts.parts.values():
        lowest = transforms.apply(part.resting(0.0, 0.0, 0.3, -20.0), part.vertices_mm)[:, 1].min()
        assert lowest == pytest.approx(-20.0, abs=1.5), part.name


@pytest.mark.parametrize(("kind", "parts"), SETS)
def test_mounted_parts_touch_what_they_are_on_without_being_buried_in_it(kind: SetKind, parts: PartSet) -> None:
    for part in parts.parts.values():
        if part.mount is None:
            continue
        on_parent = transforms.apply(part.mount.T_parent_from_part, part.vertices_mm)
        distance = parts.parts[part.mount.parent].signed_distance_mm(on_parent)
        assert distance.min() < 3.0, part.name
        assert np.median(distance) > -3.0, part.name


def test_a_vehicle_has_what_the_verbs_need() -> None:
    parts = draw_set("assembly", np.random.default_rng(0))
    assert nouns("assembly", 1) == {"bumper", "cabin", "chassis", "screw", "screwdriver", "wheel"}
    assert sum(part.noun == "wheel" for part in parts.parts.values()) == 4
    assert sum(part.mount is not None and part.mount.travel_mm > 0 for part in parts.parts.values()) == 5
    assert parts.tool == "screwdriver" and parts.parts[parts.workpiece].mount is None


def test_the_same_seed_gives_the_same_things_and_another_seed_others() -> None:
    one, same, other = (draw_set("assembly", np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one.toy_id == same.toy_id
    for name, part in one.parts.items():
        assert part.vertices_mm.tobytes() == same.parts[name].vertices_mm.tobytes()
        assert part.albedo.tobytes() == same.parts[name].albedo.tobytes()
    assert any(p.vertices_mm.tobytes() != other.parts[n].vertices_mm.tobytes() for n, p in one.parts.items())


def nouns(kind: SetKind, num_sets: int) -> set[str]:
    sets = (draw_set(kind, np.random.default_rng(seed)) for seed in range(num_sets))
    return {part.noun for parts in sets for part in parts.parts.values()}


def test_all_nouns_are_listed_and_the_two_sets_share_none() -> None:
    assert not nouns("assembly", 30) & nouns("desktop", 30)
    assert sorted(nouns("assembly", 30) | nouns("desktop", 30)) == list(NOUNS)


def test_the_letter_of_a_toy_says_what_it_is() -> None:
    assert [toy_name(toy, "assembly") for toy in ("a23", "b05b", "c14a")] == ["dump truck", "excavator", "fire truck"]
    assert toy_name("a23", "desktop") == "desktop things"
