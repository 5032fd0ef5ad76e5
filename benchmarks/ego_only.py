"""The paper's egocentric baseline on synthetic test subjects: 2D + triangulation on the headset's cameras alone.

    python benchmarks/ego_only.py [--takes 20] [--instants 8]

Hands of the split `test`, whom no network was trained on, are cropped out of the headset's four cameras and, at the
same instants, out of the eight fixed ones; one 2D network looks at all crops, one triangulation joins either set.
Boxes are around the true hand (γ 2.4, as loose as detected ones): nothing tells in the headset where hands are. The
network was trained on pictures of the fixed cameras alone, grey ones of a headset are new to it. Figures are of the
simulator, not of the AssemblyHands recordings.
"""

import argparse
from collections.abc import Iterator

import numpy as np

from assemblyhands_core.detectors.learned import LearnedHands
from assemblyhands_core.geometry.triangulation import triangulate
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from assemblyhands_core.metrics.keypoints import coverage_percent, joint_errors_mm, pck_auc
from assemblyhands_core.synthetic.crop_boxes import AroundHand
from assemblyhands_core.synthetic.crop_draws import draw_training_take, training_subject
from assemblyhands_core.synthetic.crop_mode import HandViews
from assemblyhands_core.synthetic.rig import RIGS

SIZE_PX = 192
BOX = AroundHand(gamma=2.4, gamma_spread=0.1, center_spread=0.03)
MAX_REPROJECTION_PX = 13.0  # of a crop: what triangulate's 20 px are in the fixed cameras' videos
MIN_PARALLAX_RAD = 0.05  # the headset's cameras stand close together; 0.2 would leave hardly a joint


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--takes", type=int, default=20)
    parser.add_argument("--instants", type=int, default=8)
    options = parser.parse_args()
    detector = LearnedHands()
    true, found = [], {"headset": [], "fixed": []}
    for views in hands(options.takes, options.instants):
        true.append(views.joints_world_mm)
        pixels, confidence = looked_at(detector, views)
        is_ego = np.array([camera.camera_id.startswith("HMC") for camera in views.cameras])
        for name, chosen in (("headset", is_ego), ("fixed", ~is_ego)):
            found[name].append(joined(views, pixels, confidence, np.flatnonzero(chosen)))
    is_known = np.full((len(true), NUM_JOINTS), True)
    print(f"{len(true)} hands of {options.takes} test subjects, synthetic")
    for name, points in found.items():
        errors = joint_errors_mm(np.stack(points), np.stack(true), is_known)
        print(
            f"{name:8}: MPJPE of found joints {np.nanmean(errors):.2f} mm (median {np.nanmedian(errors):.2f}), "
            f"PCK-AUC with missing as wrong {pck_auc(np.stack(points), np.stack(true), is_known):.1f} %, "
            f"coverage {coverage_percent(errors, is_known):.1f} %"
        )


def hands(num_takes: int, num_instants: int) -> Iterator[HandViews]:
    """Yield both hands at the instants of each take, in all views."""
    for index in range(num_takes):
        take = draw_training_take(training_subject("test", index), index, num_instants=num_instants)
        rig = RIGS[take.kind](take.day_seed)
        studio = take.open([*rig.exo, *rig.ego])
        for t_s in take.times_s:
            yield from (studio.hand_views(t_s, hand, SIZE_PX, BOX) for hand in HANDS)


def looked_at(detector: LearnedHands, views: HandViews) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (V, 21, 2) and confidence (V, 21) in the crops."""
    pixels = np.full((len(views.cameras), NUM_JOINTS, 2), np.nan)
    confidence = np.zeros(pixels.shape[:2])
    for view in np.flatnonzero(views.is_valid):
        seen = detector.detect(views.images[view], views.hand, views.cameras[view].camera_id, 0)
        if seen is not None:
            pixels[view], confidence[view] = seen.keypoints_px, seen.confidence
    return pixels, confidence


def joined(views: HandViews, pixels: np.ndarray, confidence: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the joints (21, 3) that some views give, NaN where they do not."""
    found = triangulate(
        pixels[chosen].swapaxes(0, 1),
        [views.cameras[view] for view in chosen],
        confidence[chosen].T,
        max_reprojection_px=MAX_REPROJECTION_PX,
        min_parallax_rad=MIN_PARALLAX_RAD,
    )
    return found.points_world_mm


if __name__ == "__main__":
    main()
