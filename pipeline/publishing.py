"""Put what the studio delivered where data sets have it: ``work/synthetic``, and the files that a split shares."""

import errno
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from assemblyhands_core.data.drafts import replaced_whole
from assemblyhands_core.data.layout import DatasetLayout
from assemblyhands_core.data.locks import locked
from assemblyhands_core.data.split_files import write_shared_files
from assemblyhands_core.data.store import Store
from assemblyhands_core.data.studio_tables import DELIVERED
from pipeline.config import RunConfig
from pipeline.takes import select_takes
from pipeline.tasks import Result

_NO_LINKS: Final = (errno.EXDEV, errno.EPERM, errno.ENOTSUP, errno.EMLINK)
Files = Sequence[Mapping[str, str]]


def publish(config: RunConfig, results: Sequence[Result], root: Path) -> list[str]:
    """Lay out every delivered recording; return their names.

    Files are links to those in the store where the file system allows, else copies. A recording's list of files is
    taken away first and written last: a recording without its list is not whole, and is laid out again.
    """
    layout, takes = DatasetLayout(root), {take.sequence_id: take for take in select_takes(config)}
    delivered = {name: (takes[name], files) for name, files in _deliveries(config, results)}
    if delivered:
        with _alone(root):
            for name, (_, files) in delivered.items():
                _clear(layout, name, files)
                _lay_out(layout, files)
            write_shared_files(layout, {name: take.split for name, (take, _) in delivered.items()})
            for take, files in delivered.values():
                _write_list(layout, take.heading(config), take.sequence_id, files)
    return list(delivered)


def _deliveries(config: RunConfig, results: Sequence[Result]) -> Iterator[tuple[str, Files]]:
    store = Store(config.workspace)
    for result in results:
        stage = config.dag.nodes[result.node].stage.name
        record = store.find(stage, result.key) if DELIVERED.name in result.outputs else None
        if record is not None:
            yield result.shard.sequence_id, store.read(record, DELIVERED.name, DELIVERED).to_pylist()


@contextmanager
def _alone(root: Path) -> Iterator[None]:
    """Wait until no other run publishes here; the lock falls with the process."""
    root.mkdir(parents=True, exist_ok=True)
    with locked(root / ".lock", waits=True):
        yield


def _clear(layout: DatasetLayout, recording: str, files: Files) -> None:
    """Take a recording's list away, and the files of an earlier order that are none of it any more."""
    listing = layout.delivered(recording)
    old = listing.read_text(encoding="utf-8").splitlines()[1:] if listing.is_file() else []
    listing.unlink(missing_ok=True)
    for path in {line.partition("  ")[2] for line in old} - {row["path"] for row in files}:
        (layout.root / path).unlink(missing_ok=True)


def _lay_out(layout: DatasetLayout, files: Files) -> None:
    for row in files:
        lay_out(Path(row["content_file"]), layout.root / row["path"])


def lay_out(source: Path, target: Path) -> None:
    """Put a file of the store where it belongs in a data set: a link where the file system allows, else a copy."""
    if not (target.exists() and target.samefile(source)):
        _link(source, target)


def _link(source: Path, target: Path) -> None:
    source.chmod(0o444)  # writing over a link would change the store's file, too
    with replaced_whole(target) as draft:
        try:
            os.link(source, draft)
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            shutil.copyfile(source, draft)


def _write_list(layout: DatasetLayout, heading: str, recording: str, files: Files) -> None:
    listing = layout.delivered(recording)
    lines = [heading, *(f"{row['sha256']}  {row['path']}" for row in files)]
    with replaced_whole(listing) as draft:
        draft.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
