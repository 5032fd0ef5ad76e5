"""Names of recordings and egocentric cameras, and names that must not leave their folder."""

from datetime import datetime

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.data.names import (
    RecordingName,
    checked_component,
    checked_relative_path,
    ego_calibration_name,
    ego_image_name,
    ego_serial,
    ego_video_name,
    parse_recording_name,
    recording_name,
)

NAME = "nusar-2021_action_both_9012-c07c_9012_user_id_2021-02-01_164345"
STARTS = st.datetimes(min_value=datetime(1000, 1, 1)).map(lambda start: start.replace(microsecond=0))


def test_a_real_name_in_parts() -> None:
    found = parse_recording_name(NAME)
    assert found == RecordingName(9012, "c07c", datetime(2021, 2, 1, 16, 43, 45), 9012)
    assert (str(found), found.day_seed) == (NAME, 20210201)
    assert recording_name(9012, "c07c", found.started) == NAME


def test_a_real_name_with_another_user_number() -> None:
    name = "nusar-2021_action_both_9065-a17_9095_user_id_2021-02-17_114124"
    assert (parse_recording_name(name).participant, parse_recording_name(name).user) == (9065, 9095)
    assert str(parse_recording_name(name)) == name


@given(
    participant=st.integers(0, 9999), toy=st.from_regex(r"[abc][0-9]{2}[a-z]?", fullmatch=True), start=STARTS,
    user=st.integers(0, 9999),
)  # fmt: skip
@settings(max_examples=100, deadline=None, derandomize=True)
def test_names_round_trip(participant: int, toy: str, start: datetime, user: int) -> None:
    name = RecordingName(participant, toy, start, user)
    assert parse_recording_name(str(name)) == name


@pytest.mark.parametrize(
    "name",
    [
        "", "nusar", NAME + "x", " " + NAME, NAME + "\n", NAME.replace("c07c", "d07c"),
        NAME.replace("-02-01", "-02-30"),
        NAME.replace("164345", "994345"), NAME.replace("9012-", "../9-"), NAME.replace("9012-", "９０１２-"),
    ],
)  # fmt: skip
def test_other_names_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="is no recording name"):
        parse_recording_name(name)


@pytest.mark.parametrize(("participant", "toy"), [(12345, "a01"), (-1, "a01"), (1, "d01"), (1, "a1"), (1, "a01bb")])
def test_parts_that_make_no_name(participant: int, toy: str) -> None:
    with pytest.raises(ValueError, match="four digits"):
        recording_name(participant, toy, datetime(2022, 1, 1))


@pytest.mark.parametrize(
    "name", ["84355350_mono10bit", "HMC_84355350_mono10bit", "HMC_84355350", "84355350:mono10bit", "84355350"]
)
def test_all_spellings_of_an_ego_camera(name: str) -> None:
    assert ego_serial(name) == "84355350"
    assert ego_calibration_name(name) == "84355350_mono10bit"
    assert ego_video_name(name) == "HMC_84355350_mono10bit"
    assert ego_image_name(name) == "HMC_84355350"


@pytest.mark.parametrize("name", ["C10095_rgb", "HMC_8435535", "hmc_84355350", "HMC_84355350_rgb", ""])
def test_no_ego_camera(name: str) -> None:
    assert ego_serial(name) is None
    with pytest.raises(ValueError, match="names no egocentric camera"):
        ego_video_name(name)


@pytest.mark.parametrize(
    "name", ["", ".", "..", ".hidden", "a/b", "a\\b", "a\0", "a b", "ä", "-rf", "a" * 256, 3, None]
)
def test_unsafe_components(name: object) -> None:
    with pytest.raises(ValueError, match=r"^The camera is .*: it becomes part of file names"):
        checked_component(name, "The camera")


@pytest.mark.parametrize("path", ["", "/etc/passwd", "../a", "a/../b", "a//b", "./a", "a/", "a\\b", "C:/a", "a/\0", 7])
def test_unsafe_paths(path: object) -> None:
    with pytest.raises(ValueError, match=r"^The file is"):
        checked_relative_path(path, "The file")


def test_safe_names_pass() -> None:
    assert checked_component("C10095_rgb.mp4", "x") == "C10095_rgb.mp4"
    assert checked_relative_path("images/a-1/000001.jpg", "x") == "images/a-1/000001.jpg"
