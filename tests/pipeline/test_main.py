"""How often the command line composes the configuration: most of a second each time."""

import sys
from typing import Any

import pytest
from hydra._internal.config_loader_impl import ConfigLoaderImpl

from assemblyhands_core.data.store import DamagedEntry
from pipeline import __main__ as command_line
from pipeline.config import RunConfig, UserError


@pytest.fixture
def composed(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Return the overrides of each configuration that is composed from here on."""
    found: list[list[str]] = []
    load = ConfigLoaderImpl.load_configuration

    def remember(self: Any, config_name: Any, overrides: list[str], *rest: Any, **more: Any) -> Any:
        found.append(list(overrides))
        return load(self, config_name, overrides, *rest, **more)

    monkeypatch.setattr(ConfigLoaderImpl, "load_configuration", remember)
    return found


@pytest.fixture
def executed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, RunConfig]]:
    """Return what is executed from here on, which is not."""
    found: list[tuple[str, RunConfig]] = []

    def remember(command: str, config: RunConfig, said: str) -> int:
        found.append((command, config))
        return 0

    monkeypatch.setattr(command_line, "execute", remember)
    return found


def _main(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["pipeline", *arguments])
    return command_line.main()


def test_a_run_is_composed_once(
    monkeypatch: pytest.MonkeyPatch, composed: list[list[str]], executed: list[tuple[str, RunConfig]]
) -> None:
    assert _main(monkeypatch, "plan", "rounds=2", "executor=serial") == 0
    assert composed == [["rounds=2", "executor=serial"]]
    ((command, config),) = executed
    assert (command, config.rounds, config.executor.name) == ("plan", 2, "serial")


def test_a_mistake_is_looked_for_once_there_is_one(
    monkeypatch: pytest.MonkeyPatch, composed: list[list[str]], executed: list[tuple[str, RunConfig]]
) -> None:
    with pytest.raises(UserError, match=r"there is no parameter executor\.workers; did you mean executor\.\w*workers"):
        _main(monkeypatch, "plan", "executor=serial", "executor.workers=2")
    assert composed == [["executor=serial", "executor.workers=2"], ["executor=serial"]] and not executed


def test_a_sweep_goes_through_its_points(
    monkeypatch: pytest.MonkeyPatch, executed: list[tuple[str, RunConfig]], tmp_path: Any
) -> None:
    assert _main(monkeypatch, "plan", "-m", "rounds=1,2", f"workspace={tmp_path}") == 0
    assert [config.rounds for _, config in executed] == [1, 2]


@pytest.mark.parametrize(
    ("said", "target"),
    [
        ("plan all preset=tiny", "all"),
        ("plan evaluate", "evaluate"),
        ("plan round_0 seq=a", "round_0"),
        ("plan seq=a", "annotate"),
        ("plan target=smooth", "smooth"),
    ],
)
def test_a_plan_is_of_the_target_after_it(
    monkeypatch: pytest.MonkeyPatch, executed: list[tuple[str, RunConfig]], said: str, target: str
) -> None:
    assert _main(monkeypatch, *said.split()) == 0
    assert [(command, config.target) for command, config in executed] == [("plan", target)]


@pytest.mark.parametrize(
    ("said", "sentence"),
    [("plan al", "^target=al is unknown"), ("plan all quickly", "^quickly is no parameter=value")],
)
def test_a_word_after_plan_that_names_no_target_is_refused(
    monkeypatch: pytest.MonkeyPatch, executed: list[tuple[str, RunConfig]], said: str, sentence: str
) -> None:
    with pytest.raises(UserError, match=sentence):
        _main(monkeypatch, *said.split())
    assert not executed


@pytest.mark.parametrize(
    "said", ["help", "-h", "--help", "annotate --help", "plan -h", "plan seq=a -m rounds=1 --help"]
)
def test_help_is_ours_wherever_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    executed: list[tuple[str, RunConfig]],
    said: str,
) -> None:
    assert _main(monkeypatch, *said.split()) == 0 and not executed
    out = capsys.readouterr().out
    assert out.startswith("usage: python -m pipeline") and "Hydra" not in out


def test_import_is_another_name_of_correct(
    monkeypatch: pytest.MonkeyPatch, executed: list[tuple[str, RunConfig]]
) -> None:
    assert _main(monkeypatch, "import", "corrected=a.json") == 0
    assert [command for command, _ in executed] == ["correct"] and str(executed[0][1].corrected) == "a.json"


def test_a_damaged_entry_is_said_in_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    def damaged() -> int:
        raise DamagedEntry("chunks.parquet: cut; the entry was set aside, run again")

    assert command_line._reported(damaged) == 2
    assert capsys.readouterr().err == "error: chunks.parquet: cut; the entry was set aside, run again\n"
