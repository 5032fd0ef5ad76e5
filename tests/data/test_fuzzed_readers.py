"""Whatever is in a file, its reader gives a value or one of our own errors that names the file, without much room.

Valid samples of every kind are changed by bytes and, where they are JSON, by structure; `benchmarks/fuzz_readers.py`
does the same for minutes, led by coverage.
"""

import copy
import json
import os
import resource
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reader_families import Family, NotOurs, families, outcome

FAMILIES = families()
JSON_FAMILIES = [name for name, family in FAMILIES.items() if name.endswith(".json")]
TOKENS = [
    b"", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"NaN", b"1e999", b"-1", b"9" * 5000, b"1e308", b"[" * 5000, b"{", b'"',
    b"../../../etc/passwd", b"/etc/passwd", b"\\", b"\n", b",", b"<", b"&", b"\r", b"null", b"a" * 140_000, b"0",
]  # fmt: skip
VALUES: list[Any] = [
    None, True, -1, 0, 1.5, 10**400, 1e308, float("nan"), float("inf"), "", "x", "../../etc/passwd", "/etc/passwd",
    "\ud800", "a\x00b", "\x1b[2J", [], {}, [[]], [None], {"": 0}, "9" * 50, [0] * 1000,
]  # fmt: skip
MAX_GROWTH_BYTES = 700 * 2**20
FEW = settings(
    max_examples=int(os.environ.get("ASSEMBLYHANDS_FUZZ_EXAMPLES", "40")),
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


@pytest.fixture(autouse=True, scope="module")
def bounded_memory() -> Iterator[None]:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    assert grown < MAX_GROWTH_BYTES, f"reading hostile files took {grown / 2**20:.0f} MiB"


@pytest.fixture(autouse=True)
def no_hang(unchecked_types: None) -> Iterator[None]:
    """Types are those of whoever wrote the file: what users see is how the code itself refuses them."""
    signal.signal(signal.SIGALRM, lambda *_: pytest.fail("a reader hangs"))
    signal.alarm(120)
    yield
    signal.alarm(0)


@pytest.mark.parametrize("name", FAMILIES)
def test_valid_samples_are_read_and_nothing_at_all_is_no_sample(name: str, tmp_path: Path) -> None:
    family = FAMILIES[name]
    assert [outcome(family, sample, tmp_path) for sample in family.samples] == ["value"] * len(family.samples)
    assert family.read(tmp_path / name) is not None


@pytest.mark.parametrize("name", FAMILIES)
@given(data=st.data())
@FEW
def test_changed_bytes_give_a_value_or_our_own_error(name: str, tmp_path: Path, data: st.DataObject) -> None:
    family = FAMILIES[name]
    content = data.draw(st.sampled_from(family.samples))
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(content)))
        length = data.draw(st.sampled_from([0, 1, 1, 2, 4, 16, len(content)]))
        token = data.draw(st.one_of(st.sampled_from(TOKENS), st.binary(max_size=8)))
        content = content[:start] + token + content[start + length :]
    outcome(family, content, tmp_path)


@pytest.mark.parametrize("name", JSON_FAMILIES)
@given(data=st.data())
@FEW
def test_changed_structure_gives_a_value_or_our_own_error(name: str, tmp_path: Path, data: st.DataObject) -> None:
    family = FAMILIES[name]
    document = json.loads(family.samples[0])
    for _ in range(data.draw(st.integers(1, 2))):
        if not (places := list(_places(document))):
            break
        parent, key = data.draw(st.sampled_from(places))
        how = data.draw(st.sampled_from(["replace", "drop", "rename", "repeat"]))
        if how == "replace":
            parent[key] = copy.deepcopy(data.draw(st.sampled_from(VALUES)))
        elif how == "repeat" and isinstance(parent, list):
            parent.append(parent[key])
        elif how == "rename" and isinstance(parent, dict):
            parent[data.draw(st.sampled_from(["", "x", "../x", "000001", "\ud800", "9" * 300]))] = parent.pop(key)
        else:
            del parent[key]
    outcome(family, json.dumps(document).encode(), tmp_path)


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every place in a document: what holds it, and its key there; of long lists the ends."""
    keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else []
    for key in [*keys[:6], *keys[-2:]] if len(keys) > 8 else keys:
        yield value, key
        yield from _places(value[key])


def test_an_error_that_is_not_ours_is_noticed(tmp_path: Path) -> None:
    def read(path: Path) -> object:
        return json.loads(path.read_bytes())

    with pytest.raises(NotOurs, match=r"json.decoder.JSONDecodeError"):
        outcome(Family("a.json", (), read), b"{", tmp_path)
    with pytest.raises(NotOurs, match="RecursionError"):
        outcome(Family("a.json", (), read), b"[" * 100_000, tmp_path)
    with pytest.raises(NotOurs, match="the file is not named: nothing"):
        outcome(Family("a.json", (), _refuse), b"", tmp_path)
    assert outcome(Family("a.json", (), _refuse, names_file=False), b"", tmp_path) == "nothing"


def _refuse(path: Path) -> object:
    raise ValueError("nothing")
