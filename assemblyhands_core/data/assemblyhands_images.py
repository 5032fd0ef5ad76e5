"""AssemblyHands `ego_data`: which rectified egocentric images exist, with the boxes of their hands (formats 2.4).

COCO-like: images and annotations, one annotation per image for both hands. Boxes are corners (left, top, right,
bottom) in rectified pixels, unlike COCO's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from assemblyhands_core.data.assemblyhands import KEY_RATE_HZ, frame_key, joint_flags
from assemblyhands_core.data.image_header import MAX_SIDE_PX, is_possible
from assemblyhands_core.data.json_files import (
    FormatError,
    counted_problems,
    json_list,
    json_object,
    member,
    numbers,
    read_json_object,
    whole_number,
    write_json,
)
from assemblyhands_core.data.names import checked_component, checked_relative_path, ego_image_name, ego_video_name
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS, Hand

Box = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class EgoImage:
    """One rectified image of one egocentric camera.

    Attributes:
        recording: Its recording.
        camera_id: As `names.ego_image_name` spells it, without ``_mono10bit``.
        frame_60hz: Its frame, as in `joint_3d`.
        file_name: Relative to the images' folder.
        size_px: Width and height.
        box_px: Left, top, right, bottom of each hand that is there.
        is_valid: Which joints count, right hand first.
    """

    recording: str
    camera_id: str
    frame_60hz: int
    file_name: str
    size_px: tuple[int, int]
    box_px: Mapping[Hand, Box]
    is_valid: Bool[np.ndarray, "hand=2 joint=21"]


def ego_image_file(split: str, recording: str, camera_id: str, frame_60hz: int) -> str:
    """Return where the release keeps a rectified image, relative to its images' folder."""
    camera = ego_video_name(camera_id)
    return f"ego_images_rectified/{split}/{recording}/{camera}/{frame_key(frame_60hz)}.jpg"


def write_ego_images(path: Path, images: Sequence[EgoImage]) -> None:
    """Write an `ego_data` file; ids count from 0 in the order given."""
    document = {
        "images": [_image_block(number, image) for number, image in enumerate(images)],
        "annotations": [_annotation_block(number, image) for number, image in enumerate(images)],
    }
    write_json(path, document)


def image_root(recording_folder: Path) -> Path:
    """Return the folder in which file names begin, of the folder of a recording's pictures."""
    return recording_folder.parents[2]


def read_ego_images(path: Path, recording: str | None = None) -> list[EgoImage]:
    """Read an `ego_data` file, all recordings or one, in the order of its images.

    Returns:
        Images without annotation have no box and no valid joint.

    Raises:
        FormatError: An image or annotation is not as it should be; the message says which and why.
    """
    document = read_json_object(path)
    blocks: dict[int, dict[str, Any]] = {}
    for index, value in enumerate(json_list(member(document, "images", str(path)), f"{path}: images")):
        where = f"{path}: image {index}"
        block = json_object(value, where)
        identity = whole_number(member(block, "id", where), f"{where}, id")
        if identity in blocks:
            raise FormatError(f"{where}: the id {identity} is an earlier image's; get the file again.")
        blocks[identity] = block
    annotations = _annotations(document, set(blocks), path)
    images: list[EgoImage] = []
    with counted_problems() as problems:
        for number, block in blocks.items():
            if recording in (None, block.get("seq_name")):
                with problems.noted():
                    images.append(_read_image(block, annotations.get(number), f"{path}: image {number}"))
    return images


def _image_block(number: int, image: EgoImage) -> dict[str, Any]:
    return {
        "id": number,
        "seq_name": image.recording,
        "camera": ego_image_name(image.camera_id),
        "frame_idx": image.frame_60hz,
        "file_name": image.file_name,
        "width": image.size_px[0],
        "height": image.size_px[1],
        "timestamp": image.frame_60hz / KEY_RATE_HZ,
    }


def _annotation_block(number: int, image: EgoImage) -> dict[str, Any]:
    return {
        "id": number,
        "image_id": number,
        "bbox": {hand: list(image.box_px[hand]) if hand in image.box_px else None for hand in HANDS},
        "joint_valid": image.is_valid.reshape(-1).astype(int).tolist(),
    }


def _annotations(document: Mapping[str, Any], known: set[int], path: Path) -> dict[int, dict[str, Any]]:
    blocks: dict[int, dict[str, Any]] = {}
    for index, value in enumerate(json_list(member(document, "annotations", str(path)), f"{path}: annotations")):
        where = f"{path}: annotation {index}"
        block = json_object(value, where)
        image = whole_number(member(block, "image_id", where), f"{where}, image_id")
        if image not in known or image in blocks:
            problem = "was annotated before" if image in known else "is not in the file"
            raise FormatError(f"{where}: its image {image} {problem}; get the file again.")
        blocks[image] = block
    return blocks


def _read_image(block: Mapping[str, Any], annotation: Mapping[str, Any] | None, where: str) -> EgoImage:
    recording, camera, file_name, frame, *size = (
        member(block, key, where) for key in ("seq_name", "camera", "file_name", "frame_idx", "width", "height")
    )
    width, height = (whole_number(side, f"{where}, size", 1, MAX_SIDE_PX) for side in size)
    if not is_possible(width, height):
        raise FormatError(f"{where}: {width}×{height} px are more than a picture may have; get the file again.")
    return EgoImage(
        recording=checked_component(recording, f"{where}: its seq_name"),
        camera_id=checked_component(camera, f"{where}: its camera"),
        frame_60hz=whole_number(frame, f"{where}, frame_idx", 0, 10**6 - 1),
        file_name=checked_relative_path(file_name, f"{where}: its file_name"),
        size_px=(width, height),
        box_px=_boxes(member(annotation, "bbox", where), where) if annotation else {},
        is_valid=_valid(member(annotation, "joint_valid", where) if annotation else [0] * 2 * NUM_JOINTS, where),
    )


def _boxes(value: object, where: str) -> dict[Hand, Box]:
    block = json_object(value, f"{where}, bbox")
    boxes: dict[Hand, Box] = {}
    for hand in HANDS:
        if block.get(hand) is None:
            continue
        left, top, right, bottom = numbers(block[hand], (4,), f"{where}, bbox of the {hand} hand").tolist()
        if left > right or top > bottom:
            raise FormatError(f"{where}, bbox of the {hand} hand: {block[hand]} is not left, top, right, bottom.")
        boxes[hand] = (left, top, right, bottom)
    return boxes


def _valid(value: object, where: str) -> Bool[np.ndarray, "hand=2 joint=21"]:
    return np.asarray(joint_flags(value, f"{where}, joint_valid").reshape(len(HANDS), NUM_JOINTS))
