"""A file for the viewer rerun (https://rerun.io): cameras, pictures, keypoints and joints on one time line.

The world stays in mm. Rerun counts pixels from a picture's corner, so that what is stored is ours plus half a pixel.
Points that are missing are left out of their frame's row, and a frame without any is a row without points: the viewer
would go on showing those of an earlier frame otherwise.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from assemblyhands_core.data.drafts import replaced_whole
from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.hands.joints import BONES, HANDS, JOINT_NAMES, ROOT, WRIST, Hand
from assemblyhands_core.viz.first_look import Look
from assemblyhands_core.viz.overlays import FINGER_COLORS, Color

FRAME: Final = "frame"
TIME: Final = "time"
"""Time lines: the frame's number, and seconds of the recording where its rate is known."""
WORLD: Final = "world"
PLOTS: Final = "plots"
_APPLICATION: Final = "assemblyhands"
_JOINT_RADIUS_MM: Final = 2.5
_BONE_RADIUS_MM: Final = 1.2
_KEYPOINT_RADIUS_PX: Final = -2.0  # negative: of the screen, whatever the zoom
_WRIST_COLOR: Final[Color] = (150, 150, 150)  # seen on black and on white
_INSTALL: Final = "install it, in the repository: .venv/bin/pip install -e '.[view]'"

EntityPath = Sequence[str]
Frames = Integer[np.ndarray, " frame"]


class NoRerun(RuntimeError):
    """The package rerun-sdk is not installed; the message says how to install it."""


class RerunFile:
    """A recording in the making; see `open_rerun_file`."""

    def __init__(self, stream: Any, rate_hz: float) -> None:
        self._rr, self._stream, self._rate_hz = _rerun(), stream, rate_hz
        self._plots: dict[str, None] = {}  # what they measure, in order

    def world(self, up: str) -> None:
        """Say which way is up, one of ``+x -x +y -y +z -z``, and what joints are called and coloured."""
        side = "UP" if up[0] == "+" else "DOWN"
        view = getattr(self._rr.ViewCoordinates, f"RIGHT_HAND_{up[1].upper()}_{side}")
        self._static([WORLD], view)
        joints = [
            self._rr.AnnotationInfo(id=joint, label=name, color=_joint_color(joint))
            for joint, name in enumerate(JOINT_NAMES)
        ]
        hands = [
            self._rr.ClassDescription(info=self._rr.AnnotationInfo(id=number, label=hand), keypoint_annotations=joints)
            for number, hand in enumerate(HANDS)
        ]
        self._static([WORLD], self._rr.AnnotationContext(hands))

    def camera(self, path: EntityPath, camera: Camera, depth_mm: float) -> None:
        """Add a pinhole camera's optics; with ``place`` or ``places`` it also stands somewhere.

        Args:
            path: Its entity.
            camera: Of the pictures as they are stored.
            depth_mm: How far from it the world's view shows its picture.
        """
        self._static(
            path,
            self._rr.Pinhole(
                focal_length=(camera.fx_px, camera.fy_px),
                principal_point=(camera.cx_px + 0.5, camera.cy_px + 0.5),
                resolution=(camera.width_px, camera.height_px),
                camera_xyz=self._rr.ViewCoordinates.RDF,
                image_plane_distance=depth_mm,
            ),
        )

    def place(self, path: EntityPath, T_camera_from_world: Float[np.ndarray, "4 4"]) -> None:
        """Put a camera where it stays."""
        T = np.linalg.inv(T_camera_from_world)
        self._static(path, self._rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))

    def places(self, path: EntityPath, frames: Frames, T_camera_from_world: Float[np.ndarray, "frame 4 4"]) -> None:
        """Put a camera where it is at each of these frames."""
        T = np.linalg.inv(T_camera_from_world)
        columns = self._rr.Transform3D.columns(translation=T[:, :3, 3], mat3x3=T[:, :3, :3])
        self._send(path, frames, columns)

    def picture(self, path: EntityPath, frame: int, jpeg: bytes | None) -> None:
        """Add a camera's picture at a frame; None takes the one before it away."""
        frames = np.array([frame])
        if jpeg is None:
            self._send(path, frames, self._rr.Clear.columns(is_recursive=[False]))
            return
        columns = self._rr.EncodedImage.columns(blob=[jpeg], media_type=[self._rr.MediaType.JPEG])
        self._send(path, frames, columns)

    def keypoints(
        self, path: EntityPath, frames: Frames, pixels: Float[np.ndarray, "frame joint=21 2"], hand: Hand
    ) -> None:
        """Add a hand's keypoints in a camera's stored pictures, NaN where there is none."""
        is_known = np.isfinite(pixels).all(axis=-1)
        self._static(path, self._rr.Points2D.from_fields(radii=_KEYPOINT_RADIUS_PX, show_labels=False))
        columns = self._rr.Points2D.columns(positions=pixels[is_known] + 0.5, **_ids(is_known, hand))
        self._send(path, frames, columns.partition(is_known.sum(axis=1)))

    def joints(
        self, path: EntityPath, frames: Frames, points: Float[np.ndarray, "frame joint=21 3"], hand: Hand, color: Color
    ) -> None:
        """Add a hand's joints and bones in the world, mm, NaN where there is none.

        Args:
            path: Gets ``joints``, coloured by finger, and ``bones``, all in one colour.
            frames: Their numbers.
            points: Its joints.
            hand: Which one.
            color: Of the bones.
        """
        is_known = np.isfinite(points).all(axis=-1)
        joints, bones = [*path, "joints"], [*path, "bones"]
        self._static(joints, self._rr.Points3D.from_fields(radii=_JOINT_RADIUS_MM, show_labels=False))
        columns = self._rr.Points3D.columns(positions=points[is_known], **_ids(is_known, hand))
        self._send(joints, frames, columns.partition(is_known.sum(axis=1)))
        ends = np.array(BONES)
        is_whole = is_known[:, ends].all(axis=-1)
        self._static(bones, self._rr.LineStrips3D.from_fields(colors=color, radii=_BONE_RADIUS_MM))
        columns = self._rr.LineStrips3D.columns(strips=points[:, ends][is_whole])
        self._send(bones, frames, columns.partition(is_whole.sum(axis=1)))

    def side(
        self, path: EntityPath, frames: Frames, points: Float[np.ndarray, "frame joint=21 3"], hand: Hand, color: Color
    ) -> None:
        """Add the letter R or L beyond a hand's wrist, where it hides no joint; arguments are those of `joints`."""
        forearm = 2 * points[:, WRIST] - points[:, ROOT]
        is_known = np.isfinite(forearm).all(axis=-1)
        letter = self._rr.Points3D.from_fields(radii=0.0, colors=color, labels=hand[0].upper(), show_labels=True)
        self._static([*path, "side"], letter)
        columns = self._rr.Points3D.columns(positions=forearm[is_known])
        self._send([*path, "side"], frames, columns.partition(is_known.astype(int)))

    def plot(
        self, path: EntityPath, frames: Frames, values: Float[np.ndarray, " frame"], hand: Hand, color: Color
    ) -> None:
        """Add a hand's curve over time, NaN where it has no value.

        Args:
            path: What it measures, and of which layer.
            frames: Their numbers.
            values: The curve.
            hand: The left one's is thinner.
            color: Of the layer.
        """
        is_known = np.isfinite(values)
        self._plots.setdefault(path[0])
        lines = self._rr.SeriesLines(names=f"{path[-1]}, {hand}", colors=color, widths=2.5 if hand == "right" else 1.0)
        self._static([PLOTS, *path, hand], lines)
        self._send([PLOTS, *path, hand], frames[is_known], self._rr.Scalars.columns(scalars=values[is_known]))

    def layout(self, cameras: Sequence[EntityPath], layers: Mapping[str, "Visibility"], look: Look | None) -> None:
        """Say how the viewer shows it first: the world, curves, and a view of each camera with the joints over it.

        Args:
            cameras: Their entities.
            layers: Entities below the world that hold joints, and what of them is shown at first.
            look: How one looks at the world first; None leaves it to the viewer.
        """
        import rerun.blueprint as bp

        off = bp.EntityBehavior(visible=False)
        hidden: dict[Any, Any] = {
            self._path([WORLD, name]): off for name, seen in layers.items() if not seen.has_joints
        }
        contents = [f"{self._path([WORLD, name])}/**" for name in layers]
        views = [
            bp.Spatial2DView(
                origin=self._path(path), name=path[-1], contents=["$origin/**", *contents], overrides=hidden
            )
            for path in cameras
        ]
        silent = [name for name, seen in layers.items() if not seen.has_curves]
        plots = [
            bp.TimeSeriesView(
                origin=self._path([PLOTS, kind]),
                name=kind,
                overrides={self._path([PLOTS, kind, name]): off for name in silent},
            )
            for kind in self._plots
        ]
        eye = None
        if look is not None:
            eye = bp.EyeControls3D(position=look.eye_world_mm, look_target=look.target_world_mm, eye_up=look.up_world)
        world = bp.Spatial3DView(origin=WORLD, name="world, mm", overrides=hidden, eye_controls=eye)
        left = bp.Vertical(world, *plots, row_shares=[3] + [1] * len(plots))
        panel = bp.TimePanel(timeline=FRAME, state="collapsed", play_state="paused")
        shown = bp.Horizontal(left, bp.Grid(*views), column_shares=[1, 1]) if views else left
        self._stream.send_blueprint(bp.Blueprint(shown, panel, bp.SelectionPanel(state="collapsed")))

    def _path(self, path: EntityPath) -> str:
        return str(self._rr.new_entity_path(list(path)))

    def _static(self, path: EntityPath, what: Any) -> None:
        self._stream.log(self._path(path), what, static=True, strict=True)

    def _send(self, path: EntityPath, frames: Frames, columns: Any) -> None:
        lines = [self._rr.TimeColumn(FRAME, sequence=frames)]
        if np.isfinite(self._rate_hz) and self._rate_hz > 0:
            lines.append(self._rr.TimeColumn(TIME, duration=frames / self._rate_hz))
        self._stream.send_columns(self._path(path), lines, columns, strict=True)


class Visibility(NamedTuple):
    """Whether a layer's joints, and its curves, are shown at first."""

    has_joints: bool
    has_curves: bool


@contextmanager
def open_rerun_file(path: Path, name: str, rate_hz: float) -> Iterator[RerunFile]:
    """Write a file for rerun; on leaving without error it is there, else it is not.

    What is added goes to the file at once, so that pictures need not fit into memory.

    Args:
        path: The file, ending in ``.rrd``; one that is there is replaced when the new one is whole.
        name: Of the recording, shown by the viewer; files of the same name are layers of one recording.
        rate_hz: Frames a second; without a positive one there is no time in seconds.

    Raises:
        NoRerun: The package is not installed.
    """
    rr = _rerun()
    stream = rr.RecordingStream(_APPLICATION, recording_id=name)
    with replaced_whole(path) as draft:
        try:
            stream.save(draft)
            stream.send_recording_name(name)
            yield RerunFile(stream, rate_hz)
        finally:
            stream.disconnect()  # writes the rest and the table of contents


def _ids(is_known: Any, hand: Hand) -> dict[str, Any]:
    """Return the hand and joint that each of the known points is."""
    _, joint = np.nonzero(is_known)
    return {"class_ids": np.full(len(joint), HANDS.index(hand)), "keypoint_ids": joint}


def _joint_color(joint: int) -> Color:
    return _WRIST_COLOR if joint == WRIST else FINGER_COLORS[joint // 4]


def _rerun() -> Any:
    try:
        import rerun
    except ImportError as error:
        raise NoRerun(f"the viewer's package rerun-sdk cannot be imported ({error}); {_INSTALL}") from error
    return rerun
