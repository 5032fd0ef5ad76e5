"""The DAG and every table in Markdown, printed from what runs: ``docs/tables.md``."""

from collections.abc import Iterator

import pyarrow as pa

from assemblyhands_core.data.tables import TableSpec
from pipeline.graph import (
    ACTION_EDGE,
    CORRECTION_EDGE,
    CROP_EDGE,
    EGO_EDGE,
    JUDGED_EDGE,
    LABEL_EDGE,
    MEMBER_EDGE,
    SOURCE_EDGE,
    TAKE_EDGE,
    TRUTH_EDGE,
    Dag,
)

_ORIGINS = {
    SOURCE_EDGE: "the recording's files",
    EGO_EDGE: "the headset's files",
    LABEL_EDGE: "the recording's annotations",
    ACTION_EDGE: "the recording's fine-grained labels",
    CORRECTION_EDGE: "keypoints that people set by hand",
    MEMBER_EDGE: "the manifest's sequences and splits",
    JUDGED_EDGE: "where no network of the run learns from it",
    TAKE_EDGE: "the manifest's order",
    CROP_EDGE: "the manifest's order of crops",
    TRUTH_EDGE: "the recording's ground truth",
}


def describe(dag: Dag) -> str:
    """Return the document."""
    return "\n".join([*_head(), *_nodes(dag), *_targets(dag), *_tables(dag)]) + "\n"


def _head() -> Iterator[str]:
    yield "# Nodes and tables"
    yield ""
    yield "Printed from the pipeline itself by `make docs`; do not edit. Pixels are of the camera's own video unless"
    yield "a name says `rectified`; lengths are in mm; the empty `reason` means success."
    yield ""


def _nodes(dag: Dag) -> Iterator[str]:
    yield "## The way of the data"
    yield ""
    yield "| node | stage | once per | reads | makes |"
    yield "|---|---|---|---|---|"
    for node in dag.nodes.values():
        reads = ", ".join(_ORIGINS.get(edge, f"`{edge}`") for edge in node.inputs.values())
        makes = ", ".join(f"`{name}`" for name in node.stage.outputs)
        yield f"| `{node.name}` | `{node.stage.name}` | {node.shard} | {reads} | {makes} |"
    yield ""


def _targets(dag: Dag) -> Iterator[str]:
    for target, nodes in dag.targets.items():
        yield f"`target={target}` makes {', '.join(f'`{node}`' for node in nodes)} and what they need.  "
    yield ""


def _tables(dag: Dag) -> Iterator[str]:
    yield "## Tables"
    specs = {spec.name: spec for node in dag.nodes.values() for spec in node.stage.outputs.values()}
    for spec in specs.values():
        yield ""
        yield f"### {spec.name} (version {spec.version})"
        yield ""
        yield f"One row for each {', '.join(f'`{name}`' for name in spec.key)}."
        yield ""
        yield "| column | type |"
        yield "|---|---|"
        yield from (f"| `{field.name}` | {_type(spec, field)} |" for field in spec.schema)


def _type(spec: TableSpec, field: pa.Field) -> str:
    if field.name in spec.blobs:
        return "file, relative to the store entry (absolute in `load`)"
    kind = field.type
    return f"{kind.list_size} × {kind.value_type}" if pa.types.is_fixed_size_list(kind) else str(kind)
