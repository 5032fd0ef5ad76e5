"""Put what the studio delivered where data sets have it: ``work/synthetic``, and the files that a split shares."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.data.split_files import write_shared_files
from assemblyhands_core.data.store import Store
from assemblyhands_core.data.studio_tables import DELIVERED
from pipeline.config import RunConfig
from pipeline.takes import select_takes
from pipeline.tasks import Result


def publish(config: RunConfig, results: Sequence[Result], root: Path) -> list[str]:
    """Lay out every delivered recording; return their names.

    Files are links to those in the store where the file system allows, else copies. A recording's list of files is
    written last, so that one without the list is not whole.
    """
    layout, store = DatasetLayout(root), Store(config.workspace)
    splits = {take.sequence_id: take.split for take in select_takes(config)}
    published: dict[str, str] = {}
    for result in results:
        stage = config.dag.nodes[result.node].stage.name
        record = store.find(stage, result.key) if DELIVERED.name in result.outputs else None
        if record is not None:
            name = result.shard.sequence_id
            _lay_out(store.read(record, DELIVERED.name, DELIVERED).to_pylist(), layout, name)
            published[name] = splits[name]
    if published:
        write_shared_files(layout, published)
    return list(published)


def _lay_out(rows: Sequence[dict[str, str]], layout: DatasetLayout, recording: str) -> None:
    listing = layout.delivered(recording)
    listing.parent.mkdir(parents=True, exist_ok=True)
    listing.unlink(missing_ok=True)
    for row in rows:
        _link(Path(row["content_file"]), layout.root / row["path"])
    listing.write_text("".join(f"{row['sha256']}  {row['path']}\n" for row in rows), encoding="utf-8")


def _link(source: Path, target: Path) -> None:
    if target.exists() and target.samefile(source):
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    draft = target.with_name(f".{target.name}-{os.getpid()}")
    draft.unlink(missing_ok=True)
    try:
        os.link(source, draft)
    except OSError:  # another disk, or a file system without links
        shutil.copyfile(source, draft)
    draft.rename(target)
