"""The readable view of a run: ``work/runs/<run>/<node>/<table>/<shard>.parquet``, links into the store."""

import json
import os
import platform
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from assemblyhands_core.data.digests import digest_json
from assemblyhands_core.data.drafts import draft_beside, replaced_whole
from assemblyhands_core.data.provenance import code_commit
from assemblyhands_core.data.store import Store
from pipeline.config import RunConfig
from pipeline.dag import LOOKING_TARGETS
from pipeline.graph import Node
from pipeline.tasks import Result

LATEST: Final = "latest"
"""The link to the newest run, in the place of a run's name."""


def write_view(config: RunConfig, run: str, results: Sequence[Result], command: str) -> Path:
    """Write a run's folder whole, point ``latest`` to it unless it only looked or recorded, and return it."""
    runs = config.workspace / "runs"
    draft = draft_beside(runs / run)
    draft.mkdir(parents=True)
    store = Store(config.workspace)
    nodes = [node for node in config.dag.nodes.values() if any(result.node == node.name for result in results)]
    for node in nodes:
        _write_node(draft / node.name, node, [r for r in results if r.node == node.name and r.has_entry], store)
    (draft / "run.json").write_text(json.dumps(_provenance(config, command, results), indent=1))
    folder = runs / run
    shutil.rmtree(folder, ignore_errors=True)
    draft.rename(folder)
    if config.target not in LOOKING_TARGETS and not config.starts_in_studio:
        with replaced_whole(runs / LATEST) as link:
            link.symlink_to(run)
    return folder


def node_digest(results: Sequence[Result], node: str) -> str:
    """Return one digest of all that a node made: equal digests mean equal contents, whatever machine made them."""
    return digest_json(
        {str(r.shard): {name: output.digest for name, output in r.outputs.items()} for r in results if r.node == node}
    )


def _write_node(folder: Path, node: Node, results: Sequence[Result], store: Store) -> None:
    tables = list(node.stage.outputs)
    for table in tables:
        (folder / table).mkdir(parents=True)
    shards = {}
    for result in results:
        shards[str(result.shard)] = {"key": result.key, "seconds": result.seconds, "outputs": _outputs(result)}
        for table in tables:
            link = folder / table / f"{result.shard}.parquet"
            target = store.entry(node.stage.name, result.key) / f"{table}.parquet"
            link.symlink_to(os.path.relpath(target, link.parent))
    manifest = {
        "node": node.name,
        "stage": node.stage.name,
        "configs": _configs(node, results, store),
        "tables": tables,
        "shards": shards,
    }
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=1))


def _configs(node: Node, results: Sequence[Result], store: Store) -> dict[str, Any]:
    """Return the parameters that each sequence's results were made with, as their entries say."""
    first = {result.shard.sequence_id: result for result in reversed(results)}
    records = {name: store.find(node.stage.name, result.key) for name, result in sorted(first.items())}
    return {name: record.parts["config"] for name, record in records.items() if record is not None}


def _outputs(result: Result) -> dict[str, Any]:
    return {name: asdict(output) for name, output in result.outputs.items()}


def _provenance(config: RunConfig, command: str, results: Sequence[Result]) -> dict[str, Any]:
    stages = {name: model.model_dump(mode="json") for name, model in config.stages.items()}
    return {
        "command": command,
        "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "config": {**config.model_dump(mode="json"), "stages": stages},
        "commit": code_commit(),
        "python": sys.version.split()[0],
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "versions": {
            name: version(name) for name in ("assemblyhands", "numpy", "opencv-python-headless", "pyarrow", "av")
        },
        "digests": {node: node_digest(results, node) for node in dict.fromkeys(result.node for result in results)},
        "failures": [
            {"node": r.node, "shard": str(r.shard), "status": r.status, "error": r.error}
            for r in results
            if not r.has_entry
        ],
    }
