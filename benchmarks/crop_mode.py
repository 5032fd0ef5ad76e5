"""Hand instants per second of processor time in crop mode, with everything that it takes.

    python benchmarks/crop_mode.py [--takes 2] [--kind assembly] [--size 128]

A hand instant is one hand at one instant in all fixed views (8 of the assembly rig). *Script* writes the take and
furnishes the room, *instant* poses the scene, makes its meshes and finds what is visible, shared by both hands, *crops*
draws the pictures. Other work on the machine slows all of them down alike.
"""

import argparse
import resource
import time

from assemblyhands_core.hands.joints import HANDS
from assemblyhands_core.synthetic.crop_boxes import TIGHT_BOX
from assemblyhands_core.synthetic.crop_draws import TrainingTake, draw_training_take


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--takes", type=int, default=2)
    parser.add_argument("--kind", choices=("assembly", "desktop"), default="assembly")
    parser.add_argument("--size", type=int, default=128)
    options = parser.parse_args()
    measured(draw_training_take(0, 0, options.kind, num_instants=1, duration_s=2.0), options.size)  # warms up
    drawn = [draw_training_take(subject, 0, options.kind) for subject in range(1, options.takes + 1)]
    parts = [measured(take, options.size) for take in drawn]
    script, instant, crops = (sum(values) for values in zip(*parts, strict=True))
    num_hands = len(HANDS) * sum(len(take.times_s) for take in drawn)
    total = script + instant + crops
    print(f"hand instants per second and core: {num_hands / total:.1f} in all, {num_hands / crops:.1f} crops alone")
    for name, seconds in (("script", script), ("instant", instant), ("crops", crops)):
        print(f"    {seconds / total:4.0%}  {name}: {1e3 * seconds / num_hands:.0f} ms per hand instant")
    print(f"most memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB")


def measured(take: TrainingTake, size_px: int) -> tuple[float, float, float]:
    """Return the seconds that script, instants and crops of a take need."""
    begin = time.process_time()
    studio = take.open()
    script, instant, crops = time.process_time() - begin, 0.0, 0.0
    for t_s in take.times_s:
        begin = time.process_time()
        posed = studio.at(t_s)
        _ = posed.scene.moving_surfaces, posed.is_visible  # made when first asked for
        middle = time.process_time()
        for hand in HANDS:
            posed.hand_views(hand, size_px, TIGHT_BOX)
        instant, crops = instant + middle - begin, crops + time.process_time() - middle
    return script, instant, crops


if __name__ == "__main__":
    main()
