import shutil
from typing import Any


def test_a_sequence_reads_its_chunks_in_order_whichever_were_there(toy: Any) -> None:
    first = {f"{r.node} {r.shard}": r for r in toy.run()}
    shutil.rmtree(toy.store.entry("multiply", first["times one.00000"].key))
    assert toy.status(toy.run()) == {
        "cut one": "reused", "times one.00000": "done", "times one.00001": "reused", "total one": "reused",
    }  # fmt: skip


def test_a_damaged_cutting_table_is_made_anew(toy: Any) -> None:
    first = {f"{r.node} {r.shard}": r for r in toy.run()}
    chunks = toy.store.entry("cut", first["cut one"].key) / "chunks.parquet"
    record = chunks.with_name("record.json")
    content = bytearray(chunks.read_bytes())
    content[len(content) // 4] ^= 0xFF
    chunks.write_bytes(bytes(content))
    record.touch()  # so that only reading finds it
    statuses = toy.status(toy.run())
    assert statuses["cut one"] == "done" and statuses["total one"] == "reused"
