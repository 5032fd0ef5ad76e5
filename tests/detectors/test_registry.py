import subprocess
import sys

import pytest

from assemblyhands_core.detectors import (
    DETECTOR_NAMES,
    DetectorError,
    create_body_detector,
    create_hand_detector,
    fingerprint,
)


@pytest.mark.parametrize("make", [create_body_detector, create_hand_detector])
def test_an_unknown_name_is_answered_with_the_names_there_are(make) -> None:
    with pytest.raises(
        DetectorError, match=r"no detector 'openpose': choose one of learned, mediapipe, precomputed, rtmlib"
    ):
        make("openpose")
    with pytest.raises(DetectorError, match="no detector 'openpose'"):
        fingerprint("openpose", {})


def test_an_unknown_option_is_answered_with_a_sentence() -> None:
    with pytest.raises(DetectorError, match=r"'precomputed' was given options \['colour'\].*unexpected keyword"):
        create_body_detector("precomputed", colour="red")


@pytest.mark.parametrize("name", ["mediapipe", "rtmlib"])
def test_a_missing_package_is_answered_with_the_command(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [m for m in sys.modules if m.split(".")[0] == name]:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setitem(sys.modules, name, None)
    for make in (create_body_detector, create_hand_detector):
        with pytest.raises(DetectorError, match=f"package {name}.*pip install .*{name}"):
            make(name)


def test_asking_for_the_names_imports_no_detector() -> None:
    code = (
        "import sys, assemblyhands_core.detectors as d; "
        "heavy = {'mediapipe', 'rtmlib', 'onnxruntime', 'torch'} & set(sys.modules); "
        "sys.exit(str(heavy) if heavy or len(d.DETECTOR_NAMES) != 4 else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert DETECTOR_NAMES == ("learned", "mediapipe", "precomputed", "rtmlib")
