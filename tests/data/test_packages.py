import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from assemblyhands_core.data import packages
from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.packages import PackageError, fetch_package

MEMBERS = ("demo/calib.txt", "demo/videos/*.mp4")


@pytest.fixture
def registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[dict[str, str], list[str]]:
    """A registry with one wheel; returns its pin and the list of what was downloaded."""
    wheel = tmp_path / "served" / "demo-1.0-py3-none-any.whl"
    wheel.parent.mkdir()
    with zipfile.ZipFile(wheel, "w") as archive:
        for name in ("demo/calib.txt", "demo/videos/a.mp4", "demo/videos/b.mp4", "demo/other.py"):
            archive.writestr(name, name)
    downloads: list[str] = []

    def download(requirement: str, target: Path) -> None:
        downloads.append(requirement)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(wheel.read_bytes())

    monkeypatch.setattr(packages, "_download", download)
    return {"version": "1.0", "file": wheel.name, "sha256": digest_file(wheel)}, downloads


def test_only_the_wanted_files_are_unpacked_and_the_wheel_is_fetched_once(
    tmp_path: Path, registry: tuple[dict[str, str], list[str]]
) -> None:
    pin, downloads = registry
    folders = [fetch_package("demo", pin, tmp_path / "downloads", MEMBERS) for _ in range(2)]
    assert downloads == ["demo==1.0"] and folders[0] == folders[1]
    files = {str(path.relative_to(folders[0])) for path in folders[0].rglob("*") if path.is_file()}
    assert files == {"demo/calib.txt", "demo/videos/a.mp4", "demo/videos/b.mp4"}


@pytest.mark.parametrize("name", ["demo/../../evil.mp4", "/demo/evil.mp4", "demo/videos/.evil.mp4"])
def test_files_that_would_leave_the_folder_are_not_unpacked(
    tmp_path: Path, registry: tuple[dict[str, str], list[str]], name: str
) -> None:
    wheel = tmp_path / "downloads" / registry[0]["file"]
    wheel.parent.mkdir()
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr(name, "evil")
    pin = {**registry[0], "sha256": digest_file(wheel)}
    with pytest.raises(PackageError, match=r"a file in it is .*(folder/file|part)"):
        fetch_package("demo", pin, wheel.parent, ("*.mp4",))
    assert not list(tmp_path.rglob("*evil*"))


def test_another_file_than_the_pinned_one_is_refused(
    tmp_path: Path, registry: tuple[dict[str, str], list[str]]
) -> None:
    with pytest.raises(PackageError, match="is not the pinned file"):
        fetch_package("demo", {**registry[0], "sha256": "0" * 64}, tmp_path / "downloads", MEMBERS)


def test_a_member_that_the_wheel_lacks_is_named(tmp_path: Path, registry: tuple[dict[str, str], list[str]]) -> None:
    with pytest.raises(PackageError, match=r"holds no file demo/\*\.toml"):
        fetch_package("demo", registry[0], tmp_path / "downloads", ("demo/*.toml",))


def test_a_half_unpacked_file_is_unpacked_again(tmp_path: Path, registry: tuple[dict[str, str], list[str]]) -> None:
    folder = fetch_package("demo", registry[0], tmp_path / "downloads", MEMBERS)
    (folder / "demo/calib.txt").write_text("dem")
    fetch_package("demo", registry[0], tmp_path / "downloads", MEMBERS)
    assert (folder / "demo/calib.txt").read_text() == "demo/calib.txt"


def test_a_failing_download_says_where_to_put_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Failed:
        returncode, stderr = 1, "WARNING: slow\nERROR: no matching distribution\n"

    run: Callable[..., Failed] = lambda *_, **__: Failed()  # noqa: E731
    monkeypatch.setattr(packages.subprocess, "run", run)
    pin = {"version": "1.0", "file": "demo.whl", "sha256": ""}
    with pytest.raises(PackageError, match=r"no matching distribution\. Put demo\.whl into"):
        fetch_package("demo", pin, tmp_path / "downloads", MEMBERS)
    assert list((tmp_path / "downloads").iterdir()) == []
