"""MediaPipe's hand landmark model, placed by search instead of by its palm detector.

On hands of 50–100 px the palm detector is the weak link: it misses every third hand that the landmark model finds when
it is pointed there. A crop already tells where the hand is; only its direction is open. So the model looks in a few
directions, says how sure it is that this is a hand, and the surest looks are refined around what they found.
"""

import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from assemblyhands_core.detectors._packages import import_package
from assemblyhands_core.detectors.base import FloatArray, ImageRGB
from assemblyhands_core.hands.joints import Hand

# MediaPipe names hands as in a mirrored (selfie) picture: its "Left" is a right hand of an ordinary image.
MIRRORED_LABEL: Final[dict[Hand, str]] = {"right": "Left", "left": "Right"}

# In MediaPipe's own order: the wrist, the middle finger's base, and the joints that span a region (no tips).
_WRIST: Final = 0
_MIDDLE_BASE: Final = 9
_SPANNING: Final = (0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18)

# The model was trained on regions twice the span of these joints, moved a little towards the fingertips.
_REGION_OVER_SPAN: Final = 2.0
_SHIFT_TO_TIPS: Final = 0.1

_MAX_REGION_OVER_CROP: Final = 2.0
_MIN_REGION_OVER_CROP: Final = 0.1

# How much the right side, and a place in the middle of the crop, count beside the model's belief in a hand.
_SIDE_WORTH: Final = 0.2
_OFFSET_COST: Final = 0.3
_TOLERATED_LOSS: Final = 0.1
_NUM_REFINED: Final = 2

_PRESENCE_STREAM: Final = "handlandmarkcpu__hand_presence_score"
_GRAPH: Final = """
input_stream: "image"
input_stream: "region"
input_side_packet: "complexity"
output_stream: "landmarks"
output_stream: "handedness"
node {
  calculator: "HandLandmarkCpu"
  input_side_packet: "MODEL_COMPLEXITY:complexity"
  input_stream: "IMAGE:image"
  input_stream: "ROI:region"
  output_stream: "LANDMARKS:landmarks"
  output_stream: "HANDEDNESS:handedness"
}
"""


class Region(NamedTuple):
    """A square of an image that the model looks at: centre and side in px, and the direction of the fingers."""

    x_px: float
    y_px: float
    side_px: float
    rotation_rad: float  # clockwise; 0 = fingers point up


class Look(NamedTuple):
    """What the model sees in a region."""

    keypoints_px: FloatArray  # (21, 2) MediaPipe's order, pixel-centre convention
    label: str
    label_probability: float
    presence: float

    def probability_of(self, hand: Hand) -> float:
        """Return how likely this is that hand rather than the other."""
        is_it = self.label == MIRRORED_LABEL[hand]
        return self.label_probability if is_it else 1.0 - self.label_probability


def close_with(owner: object, close: Callable[[], object]) -> None:
    """Close a graph of MediaPipe when its owner goes: a graph that is only forgotten keeps some 80 MB for ever."""
    weakref.finalize(owner, close).atexit = False  # by then its threads may be gone


class HandLandmarkModel:
    """The landmark model as a MediaPipe graph; its results depend on image and region alone."""

    def __init__(self, model_complexity: int, install: str) -> None:
        mediapipe = import_package("mediapipe", install)
        framework = import_package("mediapipe.python._framework_bindings", install)
        framework.resource_util.set_resource_dir(str(Path(mediapipe.__file__).parents[1]))
        self._packets = import_package("mediapipe.python.packet_creator", install)
        self._getter = import_package("mediapipe.python.packet_getter", install)
        self._rectangle = import_package("mediapipe.framework.formats.rect_pb2", install).NormalizedRect
        self._format = framework.image_frame.ImageFormat.SRGB
        self._outputs: dict[str, Any] = {}
        self._time = 0
        self._graph = framework.calculator_graph.CalculatorGraph(graph_config=_configuration(framework, install))
        for stream in ("landmarks", "handedness", _PRESENCE_STREAM):
            self._graph.observe_output_stream(stream, self._outputs.__setitem__, False)
        self._graph.start_run({"complexity": self._packets.create_int(model_complexity)})
        close_with(self, self._graph.close)

    def look(self, image_rgb: ImageRGB, region: Region) -> Look:
        """Return what the model takes the region of an image (H, W, 3) for; it always finds something."""
        height, width = image_rgb.shape[:2]
        rectangle = self._rectangle(
            x_center=(region.x_px + 0.5) / width,
            y_center=(region.y_px + 0.5) / height,
            width=region.side_px / width,
            height=region.side_px / height,
            rotation=region.rotation_rad,
        )
        self._time += 1
        self._outputs.clear()
        image = self._packets.create_image_frame(data=image_rgb, image_format=self._format)
        self._graph.add_packet_to_input_stream("image", image.at(self._time))
        self._graph.add_packet_to_input_stream("region", self._packets.create_proto(rectangle).at(self._time))
        self._graph.wait_until_idle()
        landmarks = self._getter.get_proto(self._outputs["landmarks"]).landmark
        side = self._getter.get_proto(self._outputs["handedness"]).classification[0]
        presence = self._getter.get_float(self._outputs[_PRESENCE_STREAM])
        return Look(landmarks_px(landmarks, width, height), side.label, float(side.score), float(presence))


class _Judged(NamedTuple):
    """A look together with how well it answers the question."""

    worth: float
    look: Look


def search_hand(
    model: Any,
    image_rgb: ImageRGB,
    hand: Hand,
    center_px: FloatArray,
    side_px: float,
    num_directions: int,
    num_refinements: int,
) -> Look:
    """Return the best look at one hand.

    Args:
        model: a ``HandLandmarkModel``.
        image_rgb: (H, W, 3) a crop.
        hand: which hand is looked for.
        center_px: (2,) where it should be.
        side_px: side of the region first looked at.
        num_directions: in how many directions the fingers may point at first.
        num_refinements: how often the region is placed anew around what was found.
    """

    def judged(look: Look) -> _Judged:
        offset = np.linalg.norm(look.keypoints_px.mean(axis=0) - center_px) / min(image_rgb.shape[:2])
        worth = look.presence + _SIDE_WORTH * look.probability_of(hand) - _OFFSET_COST * float(offset)
        return _Judged(worth, look)

    turns = 2 * np.pi * np.arange(num_directions) / num_directions
    starts = [Region(float(center_px[0]), float(center_px[1]), side_px, float(turn)) for turn in turns]
    first = sorted((judged(model.look(image_rgb, region)) for region in starts), key=lambda found: -found.worth)
    return max(
        (_refined(model, image_rgb, found, judged, num_refinements) for found in first[:_NUM_REFINED]),
        key=lambda found: found.worth,
    ).look


def _refined(
    model: Any, image_rgb: ImageRGB, found: _Judged, judged: Callable[[Look], _Judged], num_refinements: int
) -> _Judged:
    """Return the last look that did not lose much by looking closer."""
    crop_px = min(image_rgb.shape[:2])
    for _ in range(num_refinements):
        region = region_around(found.look.keypoints_px)
        if not _MIN_REGION_OVER_CROP * crop_px < region.side_px < _MAX_REGION_OVER_CROP * crop_px:
            break
        closer = judged(model.look(image_rgb, region))
        if closer.worth < found.worth - _TOLERATED_LOSS:
            break
        found = closer
    return found


def region_around(keypoints_px: FloatArray) -> Region:
    """Return the region that the model wants to see a hand in.

    Args:
        keypoints_px: (21, 2) MediaPipe's order.
    """
    forward = keypoints_px[_MIDDLE_BASE] - keypoints_px[_WRIST]
    rotation = float(np.arctan2(forward[0], -forward[1]))
    cosine, sine = np.cos(rotation), np.sin(rotation)
    to_upright = np.array([[cosine, sine], [-sine, cosine]])
    upright = keypoints_px[list(_SPANNING)] @ to_upright.T
    low, high = upright.min(axis=0), upright.max(axis=0)
    center = (low + high) / 2 - np.array([0.0, _SHIFT_TO_TIPS * (high[1] - low[1])])
    x_px, y_px = to_upright.T @ center
    return Region(float(x_px), float(y_px), _REGION_OVER_SPAN * float((high - low).max()), rotation)


def landmarks_px(landmarks: Sequence[Any], width_px: int, height_px: int) -> FloatArray:
    """Return (n, 2) pixels of normalised landmarks; 0 is the image's left edge, at -0.5 px, and 1 its right edge."""
    normalised = np.array([(landmark.x, landmark.y) for landmark in landmarks], dtype=np.float64)
    pixels: FloatArray = normalised * np.array([width_px, height_px]) - 0.5
    return pixels


def _configuration(framework: Any, install: str) -> Any:
    """Return the graph with the belief in a hand as an output, and nothing withheld for lack of it."""
    text_format = import_package("google.protobuf.text_format", install)
    config_type = import_package("mediapipe.framework.calculator_pb2", install).CalculatorGraphConfig
    options = import_package("mediapipe.calculators.util.thresholding_calculator_pb2", install)
    validated = framework.validated_graph_config.ValidatedGraphConfig()
    validated.initialize(graph_config=text_format.Parse(_GRAPH, config_type()))
    expanded = config_type()
    expanded.ParseFromString(validated.binary_config)
    expanded.output_stream.append(_PRESENCE_STREAM)
    for node in expanded.node:
        if node.calculator == "ThresholdingCalculator":
            node.options.Extensions[options.ThresholdingCalculatorOptions.ext].threshold = 0.0
    return expanded
