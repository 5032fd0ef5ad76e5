from pathlib import Path

from assemblyhands_core.models.warm import load_once


def test_what_is_loaded_stays_until_the_file_changes(tmp_path: Path) -> None:
    loads: list[Path] = []

    def load(path: Path) -> list[str]:
        loads.append(path)
        return [path.read_text()]

    path = tmp_path / "weights"
    path.write_text("one")
    first = load_once(load, path)
    assert load_once(load, path) is first == ["one"] and loads == [path]
    path.write_text("two")  # as long, within the same second: only the contents tell
    assert load_once(load, path) == ["two"] and loads == [path, path]
    path.write_text("one")
    assert load_once(load, path) is first, "several are kept: a worker goes from one stage to another and back"
