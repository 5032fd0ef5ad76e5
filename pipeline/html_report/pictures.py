"""Pictures as data URIs: figures as SVG, photographs as JPEG."""

import base64
import io
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from assemblyhands_core.data.crop_images import encode_jpeg
from assemblyhands_core.viz.figures import DPI
from assemblyhands_core.viz.overlays import Image
from pipeline.html_report.page import Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_JPEG_QUALITY: Final = 85
_MAX_WIDTH_PX: Final = 1500


def from_figure(figure: "Figure", alt: str) -> Picture:
    """Return a figure as a picture that is sharp at any size, and the same whenever it is drawn."""
    import matplotlib

    file = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "assemblyhands"}):
        figure.savefig(file, format="svg", metadata={"Date": None})
    return Picture(_uri("image/svg+xml", file.getvalue()), alt, width_px=round(DPI * figure.get_figwidth()))


def from_image(image: Image, alt: str, caption: str = "", width_px: int | None = None) -> Picture:
    """Return an RGB image as a picture, smaller where it is wide."""
    scale = min(1.0, _MAX_WIDTH_PX / image.shape[1])
    size = round(image.shape[1] * scale), round(image.shape[0] * scale)
    smaller = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8) if scale < 1 else image
    return Picture(_uri("image/jpeg", encode_jpeg(smaller, _JPEG_QUALITY)), alt, caption, width_px)


def from_file(path: Path) -> Picture | None:
    """Return a picture file's; nothing where it is none, a film for example."""
    image = cv2.imread(str(path)) if path.suffix in (".png", ".jpg") else None
    return (
        None
        if image is None
        else from_image(np.asarray(image[:, :, ::-1], np.uint8), f"Drawn by this run: {path.name}")
    )


def _uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
