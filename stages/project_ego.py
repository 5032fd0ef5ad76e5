"""Project annotated hands into the headset's cameras and cut them out: the crops that SVEgoNet learns from.

One row for each hand and camera at every frame that has joints: a crop with its exact camera, both hands' joints in
that camera's frame and in pixels, and whether it shows one hand or both; or the reason why there is no crop. Lens
distortion is removed while cropping (paper, supplement, "Processing of egocentric images"). Pictures that come with
boxes, as the release's do, are cropped around those, annotated or not.
"""

from collections.abc import Mapping
from typing import Any

from assemblyhands_core.data.crop_images import ImageRGB
from assemblyhands_core.data.ego_boxes import OUTSIDE_VIEW, EgoBox
from assemblyhands_core.data.ego_crop_rows import ego_crop_row, ego_hole_row
from assemblyhands_core.data.ego_tables import EGO_CROPS
from assemblyhands_core.data.ego_views import EGO_INPUTS, EgoHands, EgoView, ego_hands, ego_views
from assemblyhands_core.geometry.regions import cut_region
from assemblyhands_core.hands.joints import HANDS, Hand
from stages._contract import Context, Stage, Tables
from stages._ego_crops import EgoCropsConfig

Row = dict[str, Any]


class ProjectEgoConfig(EgoCropsConfig):
    """Parameters of projection."""


def run(config: ProjectEgoConfig, inputs: Tables, context: Context) -> Tables:
    """Project and crop one chunk of frames."""
    hands = ego_hands(inputs)
    rows = [row for view in ego_views(inputs) for row in _rows(config, view, hands, context)]
    return {"crops": EGO_CROPS.from_rows([{"sequence_id": context.sequence_id, **row} for row in rows])}


def _rows(config: ProjectEgoConfig, view: EgoView, hands: Mapping[int, EgoHands], context: Context) -> list[Row]:
    """Return what became of both hands at each frame of one camera."""
    boxes = {frame: view.hand_boxes(frame, both, config.rule()) for frame, both in hands.items()}
    rows = {
        (frame, hand): ego_hole_row(box) for frame, both in boxes.items() for hand, box in zip(HANDS, both, strict=True)
    }
    wanted = [frame for frame, both in boxes.items() if any(not box.reason for box in both)]
    for frame, picture in view.pictures(wanted, context.num_threads):
        for hand, box in zip(HANDS, boxes.get(frame, ()), strict=False):
            if box.reason:
                continue
            if isinstance(picture, str):
                rows[frame, hand]["reason"] = picture
            else:
                rows[frame, hand] = _crop(config, view, frame, picture, hands[frame], hand, box)
    return [{"frame": frame, "hand": hand, "camera_id": view.camera_id, **row} for (frame, hand), row in rows.items()]


def _crop(
    config: ProjectEgoConfig, view: EgoView, frame: int, picture: ImageRGB, hands: EgoHands, hand: Hand, box: EgoBox
) -> Row:
    """Return a hand's crop with the labels of both hands."""
    rectified = view.camera_at(frame)
    region = cut_region(picture, rectified, view.grid, box.center_px, box.side_px, config.size_px)
    if region is None:
        return ego_hole_row(box, OUTSIDE_VIEW)
    row = ego_crop_row(
        (region.image, region.camera),
        rectified,
        hands.joints_world_mm,
        view.known_joints(frame, hands),
        hand,
        box,
        config.rule(),
        jpeg_quality=config.jpeg_quality,
    )
    return row | {"verb": view.verbs.get(frame, ""), "source": hands.sources[HANDS.index(hand)]}


STAGE = Stage(
    name="project_ego",
    version=2,
    config=ProjectEgoConfig,
    inputs=EGO_INPUTS,
    outputs={"crops": EGO_CROPS},
    run=run,
    shard="chunk",
)
