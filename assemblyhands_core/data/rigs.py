"""Camera rigs: calibrations of any supported format, recognised by content, and the videos that go with them."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from assemblyhands_core.data.assemblyhands_rig import read_exo_calibration
from assemblyhands_core.data.calibrations import UnknownFormatError
from assemblyhands_core.data.calibrations.anipose import LengthUnit, parse_anipose
from assemblyhands_core.data.calibrations.qualisys import parse_qualisys
from assemblyhands_core.data.image_header import is_possible
from assemblyhands_core.data.json_files import kind_of, read_bytes
from assemblyhands_core.data.names import is_file_part
from assemblyhands_core.geometry.cameras import Camera, load_assembly101_calibration

__all__ = ["LengthUnit", "VideoMatch", "match_videos", "read_calibration"]

SUPPORTED = "Assembly101 JSON, AssemblyHands calib.txt, anipose or Pose2Sim TOML, Qualisys .qca.txt (XML)"
MAX_CALIBRATION_BYTES = 4 * 2**20
_JSON_START = re.compile(r"\s*(\[\s*)?\{")  # a TOML file may begin with [ too, but never with [{ or {

_EXO_START = re.compile(r"\s*\S+\s*\n\s*[-+.\d]\S*[ \t]+\S+[ \t]+\S+\s*\n")  # a name, then three numbers


def read_calibration(path: Path | str, unit: LengthUnit = "auto") -> dict[str, Camera]:
    """Read the cameras of a calibration file, whatever its name.

    Args:
        path: Assembly101 JSON, AssemblyHands `calib.txt`, anipose or Pose2Sim TOML, or Qualisys `.qca.txt`.
        unit: Unit of length of a TOML file, which does not say it; `auto` is explained at `parse_anipose`. The other
            formats are in mm.

    Returns:
        Cameras by name (serial number), in mm, in the order of the file.

    Raises:
        ValueError: The file is missing, unreadable, of no supported format, or one of its cameras is impossible; the
            message is one sentence with file, camera, reason and remedy.
    """
    path = Path(path)
    text = _read_text(path)
    if _JSON_START.match(text):
        cameras = load_assembly101_calibration(path)
    elif _EXO_START.match(text):
        cameras = read_exo_calibration(path)
    else:
        try:
            cameras = parse_qualisys(text) if text.lstrip().startswith("<") else parse_anipose(text, unit)
        except UnknownFormatError as error:
            raise ValueError(f"{path}: {error}; supported are {SUPPORTED}.") from error
        except ValueError as error:
            raise ValueError(f"{path}: {str(error).removesuffix('.')}.") from error
    if not cameras:
        raise ValueError(f"{path}: holds no camera; supported are {SUPPORTED}.")
    for name, camera in cameras.items():
        _check(camera, f"{path}: camera {kind_of(name)}")
    return cameras


def _check(camera: Camera, where: str) -> None:
    """Refuse what a file's numbers and names would lead to later: pictures of any size, and files anywhere."""
    if not is_file_part(camera.camera_id):
        raise ValueError(f"{where}: its name becomes part of file names; use letters, digits, spaces, - _ and .")
    if not is_possible(camera.width_px, camera.height_px):
        raise ValueError(f"{where}: no picture has {camera.width_px}×{camera.height_px} px; correct its size.")


def _read_text(path: Path) -> str:
    try:
        if not path.is_file():
            raise ValueError(f"{path}: no such file; check rig.calibration.")
        if (size := path.stat().st_size) > MAX_CALIBRATION_BYTES:
            raise ValueError(f"{path}: {size / 2**20:.0f} MiB is no calibration; supported are {SUPPORTED}.")
        data = read_bytes(path, MAX_CALIBRATION_BYTES)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}); check its permissions.") from error
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = "\0"
    if not text.strip() or "\0" in text:
        raise ValueError(f"{path}: is {'binary' if text.strip() else 'empty'}; supported are {SUPPORTED}.")
    return text


@dataclass(frozen=True)
class VideoMatch:
    """Which video shows which camera.

    Attributes:
        video_by_camera: Matched pairs, by camera in the order of the calibration.
        problems: One sentence for each video that is left over, by path.
    """

    video_by_camera: dict[str, Path]
    problems: dict[Path, str]


def match_videos(videos: Iterable[Path], camera_ids: Iterable[str]) -> VideoMatch:
    """Match videos to cameras by file name.

    The name without suffix must be the camera's; failing that, they must agree in letters (of either case) and digits;
    failing that, one camera's name must be part of the file's (`Miqus_3_23087.avi` for camera 23087), where a number
    counts only as a whole. Cameras without video are no problem: calibrations often hold marker cameras.

    Args:
        videos: Paths of the videos.
        camera_ids: Names in the calibration.
    """
    names = list(camera_ids)
    found: dict[str, list[Path]] = {}
    problems: dict[Path, str] = {}
    for video in sorted(videos):
        candidates = _candidates(video.stem, names)
        if len(candidates) == 1:
            found.setdefault(candidates[0], []).append(video)
        else:
            known = ", ".join(candidates or names)
            why = "could show several cameras" if candidates else "has the name of no camera of the calibration"
            problems[video] = f"{video}: {why} ({known}); rename it to <camera>{video.suffix}."
    for name, paths in found.items():
        if len(paths) > 1:
            shown = ", ".join(str(path) for path in paths)
            problems |= {path: f"{path}: several videos claim camera {name} ({shown}); keep one." for path in paths}
    return VideoMatch({name: found[name][0] for name in names if len(found.get(name, ())) == 1}, problems)


def _candidates(stem: str, names: list[str]) -> list[str]:
    if stem in names:
        return [stem]
    equal = [name for name in names if _plain(name) == _plain(stem)]
    return equal or [name for name in names if _contains(_plain(stem, " "), _plain(name, " "))]


def _plain(name: str, separator: str = "") -> str:
    return separator.join(re.findall(r"[a-z]+|[0-9]+", name.lower()))


def _contains(stem: str, name: str) -> bool:
    """Whether the words and numbers of a name occur in a row in those of the stem."""
    return bool(name) and f" {name} " in f" {stem} "
