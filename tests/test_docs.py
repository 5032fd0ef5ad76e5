"""What the documents tell a user to type, and what they count."""

import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterator

from command_line import REPOSITORY

from pipeline.dag import build_dag
from pipeline.graph import EGO_EDGE, MEMBER_EDGE, SOURCE_EDGE

DOCUMENTS = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]


def _optional_packages() -> Iterator[tuple[str, str]]:
    """Yield what is installed by pip with optional packages, in documents and sentences, with the file's name."""
    sources = [path for name in ("pipeline", "assemblyhands_core") for path in (REPOSITORY / name).rglob("*.py")]
    for path in [*DOCUMENTS, *sources]:
        for found in re.findall(r"pip install ([^`\n]*?\[\w+\]\S?)", path.read_text()):
            yield found, path.name


def test_optional_packages_are_installed_from_the_checkout() -> None:
    known = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    right = {f"-e '.[{name}]'" for name in known}
    said = list(_optional_packages())
    assert {"README.md", "cluster.md", "notebooks.md", "ssh_cluster.py", "rerun_file.py"} <= {name for _, name in said}
    assert [(what, name) for what, name in said if what.removeprefix("-c constraints.txt ") not in right] == []


def test_the_environment_is_active_before_python_is_called() -> None:
    for name in ("README.md", "docs/assemblyhands.md"):
        text = (REPOSITORY / name).read_text()
        assert 0 < text.find("\n. .venv/bin/activate") < text.index("\npython -m pipeline")


def _num_shards(*targets: str) -> str:
    """Return how many shards the paper's set has, as `benchmarks/paper_scale.py` divides it, in groups of digits."""
    num_sequences, num_instants, chunk_frames = 34, 293_000, 128
    dag = build_dag()
    origins = {edge for node in dag.nodes.values() for edge in node.inputs.values() if "." not in edge}
    absent = origins - {SOURCE_EDGE, EGO_EDGE, MEMBER_EDGE}
    nodes = Counter(node.shard for node in dag.upto(tuple(n for t in targets for n in dag.targets[t]), absent))
    num_chunks = math.ceil(num_instants // num_sequences / chunk_frames)
    return f"{num_sequences * (nodes['chunk'] * num_chunks + nodes['sequence']) + nodes['set']:,}".replace(",", " ")


def test_shards_of_the_papers_set_are_counted() -> None:
    text = " ".join((REPOSITORY / "docs" / "cluster.md").read_text().split())
    both = _num_shards("annotate", "predict")
    assert f"has {_num_shards('annotate')} for `annotate` and {both} for `annotate` and `predict`" in text
    assert f"all {both} shards" in (REPOSITORY / "docs" / "reliability.md").read_text()
