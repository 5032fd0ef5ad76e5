import json
from pathlib import Path

import pytest
from finished_run import write_rounds
from rich.console import Console

from pipeline.summary import print_rounds


def _said(run: Path, capsys: pytest.CaptureFixture[str], *synthetic: str) -> list[str]:
    print_rounds(Console(width=60), run, synthetic)
    return capsys.readouterr().out.splitlines()


def _manifest(run: Path, weights: str = "weights/mvexonet.safetensors") -> None:
    for number in (1, 2):
        (run / f"round_{number}" / "manifest.json").write_text(json.dumps({"configs": {"s": {"weights": weights}}}))


def test_each_round_says_what_became_of_its_hands_and_what_the_weights_have_seen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for chunk in (0, 1):
        write_rounds(tmp_path, "s", chunk, [[0.0, 1.0, 2.0]] * 2)
    _manifest(tmp_path)
    first, second, note = _said(tmp_path, capsys)
    assert first.startswith(
        "s, round_1: 4 hands, estimated 100.0 %; new estimates moved by 1.0 mm"
    ) and second.startswith("s, round_2: ")
    assert "have seen synthetic hands alone" in note
    _manifest(tmp_path, "mine.safetensors")
    assert len(_said(tmp_path, capsys)) == 2
    _manifest(tmp_path, str(Path(__file__).parents[2] / "weights/mvexonet.safetensors"))
    assert len(_said(tmp_path, capsys)) == 3, "the same file by its whole path"
    assert len(_said(tmp_path, capsys, "s")) == 2, "on synthetic hands there is nothing to warn of"
