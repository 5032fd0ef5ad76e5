"""File names from camera names that users chose."""

import string

from hypothesis import given, settings
from hypothesis import strategies as st

from assemblyhands_core.data.blob_names import blob_name

SAFE = set(string.ascii_letters + string.digits + "_-.")


def test_plain_names_stay_as_they_are() -> None:
    assert blob_name("C10095_rgb", ".mp4") == "C10095_rgb.mp4"


def test_odd_names_stay_apart_inside_the_folder() -> None:
    names = ["a/b", "a:b", "a_b", "", ".", "..", "../a"]
    files = [blob_name(name, ".mp4") for name in names]
    assert len(set(files)) == len(names)
    assert files[2] == "a_b.mp4" and not any(file.startswith(".") or "/" in file for file in files)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(name=st.text(), other=st.text())
def test_different_names_give_different_safe_files(name: str, other: str) -> None:
    assert set(blob_name(name, ".mp4")) <= SAFE
    assert (blob_name(name, "") == blob_name(other, "")) == (name == other)
