"""Taking, putting down, fitting and removing as keys of hands and parts.

Every move starts and ends at rest and returns when it ends, in s. A hand reaches from a distance with open fingers,
closes them at rest, and lets go the same way. What is gripped in one way and used in another is turned in the fingers
on the way.
"""

import numpy as np

from assemblyhands_core.geometry import transforms
from assemblyhands_core.hands.joints import Hand
from assemblyhands_core.synthetic.bench import BACK_OFF_MM, Bench
from assemblyhands_core.synthetic.clearance import travel
from assemblyhands_core.synthetic.handling import (
    LABEL_START,
    OUT_MM,
    from_root,
    hand_key,
    let_go,
    lift,
    make_room,
    present,
    reach,
    regrip_cost,
    take,
    turn_in_fingers,
    wiggle,
)
from assemblyhands_core.synthetic.motion import WORLD, shifted
from assemblyhands_core.synthetic.placing import best_spot, best_way
from assemblyhands_core.synthetic.presenting import best_presentation


def pick_up(bench: Bench, hand: Hand, name: str, t_s: float) -> float:
    """Take a part from the table and lift it."""
    part, start_s = bench.part(name), bench.wait(hand, t_s)
    T_world_from_part = bench.at(start_s).T_world_from(name)
    ways = bench.ways(name, part.pick, hand)
    index = best_way(bench, hand, ways, T_world_from_part)
    held = ways.held(name, index)
    T_world_from_grip = T_world_from_part @ held.T_part_from_grip
    make_room(bench, hand, transforms.apply(T_world_from_part, ways.joints_mm[index]), start_s)
    near_s, closed_s = reach(bench, hand, WORLD, T_world_from_grip, held.grip)
    take(bench, hand, held, closed_s)
    end_s = lift(bench, hand, T_world_from_grip, held.grip)
    bench.label("pick up", name, hand, start_s + LABEL_START * (near_s - start_s), end_s)
    return end_s


def put_down(bench: Bench, hand: Hand, t_s: float) -> float:
    """Put what a hand holds on a free spot of the table."""
    start_s, part = bench.wait(hand, t_s), bench.part(bench.held[hand].part)
    ways = bench.ways(part.name, part.pick, hand) if part.work else bench.present_way(hand)
    T_world_from_part, index = best_spot(bench, hand, ways, part.name)
    make_room(bench, hand, transforms.apply(T_world_from_part, ways.joints_mm[index]), start_s)
    held = ways.held(part.name, index)
    grip, T_world_from_grip = held.grip, T_world_from_part @ held.T_part_from_grip
    above = transforms.rigid(T_world_from_grip[:3, :3], T_world_from_grip[:3, 3] + (0.0, BACK_OFF_MM, 0.0))
    near_s = travel(bench, hand, hand_key(start_s, WORLD, above, grip, lift_mm=20.0))
    turn_in_fingers(bench, hand, held, start_s, near_s)
    down_s = bench.move(hand, hand_key(near_s + 0.3 * bench.tempo, WORLD, T_world_from_grip, grip, tremor=0.0))
    bench.carry(part.name, WORLD, T_world_from_part, down_s)
    del bench.held[hand]
    open_s, end_s = let_go(bench, hand, WORLD, T_world_from_grip, grip)
    bench.label("put down", part.name, hand, start_s + LABEL_START * (near_s - start_s), open_s)
    return end_s


def position(bench: Bench, t_s: float) -> float:
    """Put what the working hand holds where it belongs."""
    hand, start_s = bench.worker, bench.wait(bench.worker, t_s)
    part = bench.part(bench.held[hand].part)
    root, mount = bench.parts.root(part.name), part.mount
    if mount is None:
        raise ValueError(f"Part {part.name} has no mount, so that it cannot be positioned: put it down.")
    ways = bench.ways(part.name, part.working_grip, hand)
    turns = [2 * np.pi * i / mount.num_turns for i in range(mount.num_turns)]
    T_root_from_parent = from_root(bench, root, mount.parent, start_s)
    places = [T_root_from_parent @ bench.T_parent_from_mounted(part.name, turn, mount.travel_mm) for turn in turns]
    regrip = regrip_cost(bench.held[hand], ways)
    choice = best_presentation(bench, ways, root, start_s, np.stack(places)[:, None], (part.name,), regrip)
    presented_s = present(bench, root, choice.T_world_from_root, start_s)
    place, held = places[choice.place], ways.held(part.name, choice.way)
    T_part_from_grip, grip = held.T_part_from_grip, held.grip
    near = place @ shifted(z_mm=OUT_MM) @ T_part_from_grip
    near_s = travel(bench, hand, hand_key(max(start_s, presented_s - 0.1), root, near, grip, lift_mm=15.0))
    turn_in_fingers(bench, hand, held, start_s, near_s)
    wiggle(bench, hand, root, place @ shifted(z_mm=0.25 * OUT_MM), T_part_from_grip, grip)
    there_s = bench.end_s(hand) + bench.tempo * bench.rng.uniform(0.25, 0.6)
    there_s = bench.move(hand, hand_key(there_s, root, place @ T_part_from_grip, grip, tremor=0.0))
    bench.mounted[part.name] = (turns[choice.place], mount.travel_mm)
    bench.carry(part.name, mount.parent, bench.T_parent_from_mounted(part.name, *bench.mounted[part.name]), there_s)
    del bench.held[hand]
    open_s, end_s = let_go(bench, hand, root, place @ T_part_from_grip, grip)
    bench.label("position", part.name, hand, start_s + LABEL_START * (near_s - start_s), open_s)
    return end_s


def remove(bench: Bench, name: str, t_s: float) -> float:
    """Take a loose part off its mount."""
    hand, start_s = bench.worker, bench.wait(bench.worker, t_s)
    part, root = bench.part(name), bench.parts.root(name)
    ways, place = bench.ways(name, part.working_grip, hand), from_root(bench, root, name, start_s)
    choice = best_presentation(bench, ways, root, start_s, place[None, None], (name,))
    presented_s = present(bench, root, choice.T_world_from_root, start_s)
    held = ways.held(name, choice.way)
    T_part_from_grip, grip = held.T_part_from_grip, held.grip
    near_s, closed_s = reach(bench, hand, root, place @ T_part_from_grip, grip, presented_s)
    take(bench, hand, held, closed_s)
    del bench.mounted[name]
    wiggle(bench, hand, root, place @ shifted(z_mm=2.0), T_part_from_grip, grip)
    out = place @ shifted(z_mm=OUT_MM) @ T_part_from_grip
    out_s = bench.end_s(hand) + bench.tempo * bench.rng.uniform(0.3, 0.6)
    out_s = bench.move(hand, hand_key(out_s, root, out, grip))
    bench.label("remove", name, hand, start_s + LABEL_START * (near_s - start_s), out_s)
    return lift(bench, hand, bench.at(out_s).T_world_from(root) @ out, grip)
