"""Whole pictures without their lens's distortion, reduced: for eyes. Networks look at crops of the full resolution."""

import cv2
import numpy as np

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.geometry.regions import RemapGrid, remap
from assemblyhands_core.viz.overlays import Tile


def reduced_size_px(width_px: int, height_px: int, max_side_px: int) -> tuple[int, int]:
    """Return the width and height of a picture reduced so that its longer side has at most so many pixels."""
    scale = min(1.0, max_side_px / max(width_px, height_px))
    return max(1, round(width_px * scale)), max(1, round(height_px * scale))


class PictureRectifier:
    """Takes a lens's distortion out of a camera's pictures.

    Attributes:
        camera: The pinhole camera of the pictures that are made.
    """

    def __init__(self, rectified: Camera, grid: RemapGrid, max_side_px: int) -> None:
        """Prepare for a camera.

        Args:
            rectified: Its pinhole of full size.
            grid: Where that one's pixels lie in the raw pictures.
            max_side_px: Of the pictures that are made.
        """
        size_px = reduced_size_px(rectified.width_px, rectified.height_px, max_side_px)
        self.camera = rectified.scaled(*size_px)
        scale = np.array(size_px) / (rectified.width_px, rectified.height_px)
        x, y = grid.window(self.camera)
        self._maps = ((x + 0.5) * scale[0] - 0.5).astype(np.float32), ((y + 0.5) * scale[1] - 0.5).astype(np.float32)

    def __call__(self, picture: Tile) -> Tile:
        """Return the rectified picture of a raw one, of full size or reduced to that of ``camera``."""
        size_px = (self.camera.width_px, self.camera.height_px)
        if picture.shape[1::-1] != size_px:
            picture = np.asarray(cv2.resize(picture, size_px, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return np.asarray(remap(picture, *self._maps))
