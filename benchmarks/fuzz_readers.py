"""How the readers of files from elsewhere stand up to a coverage-guided fuzzer (atheris, which is libFuzzer).

    pip install --target /tmp/atheris atheris          # no dependency of the project
    PYTHONPATH=/tmp/atheris python benchmarks/fuzz_readers.py --seconds 120 --side-by-side 2

Every kind of file is fuzzed in a process of its own, which may take 3 GB and 20 s for an input. What is no value and no
error of ours is a finding: it is kept below --folder with the input that made it, and the fuzzer goes on.
"""

import argparse
import json
import os
import random
import re
import resource
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[1]
MAX_BYTES = 3 * 2**30
MAX_SECONDS = 20
DICTIONARY = (
    r"\x00 \xff\xfe \xef\xbb\xbf NaN Infinity 1e999 -1 1e308 [ { \" ../ /etc/passwd \\ , < & null true 0 : ] } = \x0a"
)
KEYS = ["", "x", "../x", "000001", "\ud800", "9" * 300]
VALUES = [
    *(None, True, -1, 0, 1.5, 10**400, 1e308, float("nan"), float("inf"), "", "../../etc/passwd", "\ud800", "a\x00b"),
    *([], {}, [[]], [None], {"": 0}, [0] * 100, "9" * 50),
]
INSTRUMENTED = ["assemblyhands_core", "pipeline.manifests", "pipeline.correction_folders", "json", "csv", "tomllib"]


def fuzz(name: str, folder: Path, seconds: int) -> None:
    """Fuzz one kind of file; libFuzzer ends the process."""
    import atheris

    sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "tests")]
    with atheris.instrument_imports(include=INSTRUMENTED):
        from reader_families import NotOurs, families, outcome
    family = families()[name]
    corpus, work, found = folder / "corpus", folder / "work", folder / "findings"
    for path in (corpus, work, found):
        path.mkdir(parents=True, exist_ok=True)
    for number, sample in enumerate(family.samples):
        (corpus / f"sample{number}").write_bytes(sample)
    (folder / "dictionary").write_text("".join(f'"{token}"\n' for token in DICTIONARY.split()))

    def once(content: bytes) -> None:
        try:
            outcome(family, content, work)
        except NotOurs as error:
            place = re.sub(r"\W+", "_", _where(error))[-80:]
            (found / f"{place}.input").write_bytes(content)
            (found / f"{place}.txt").write_text(f"{error}\n")

    def mutate(content: bytes, max_size: int, seed: int) -> bytes:
        """Change JSON by its structure every other time, and anything by its bytes."""
        changed = changed_json(content, random.Random(seed)) if seed % 2 else None
        return changed if changed and len(changed) <= max_size else bytes(atheris.Mutate(content, max_size))

    longest = 4 * max(map(len, family.samples)) + 4096
    resource.setrlimit(resource.RLIMIT_DATA, (2 * MAX_BYTES, 2 * MAX_BYTES))
    atheris.Setup(
        [
            sys.argv[0],
            str(corpus),
            f"-max_total_time={seconds}",
            f"-timeout={MAX_SECONDS}",
            f"-rss_limit_mb={MAX_BYTES >> 20}",
            f"-max_len={longest}",
            f"-dict={folder / 'dictionary'}",
            f"-artifact_prefix={found}/",
            "-print_final_stats=1",
        ],
        once,
        custom_mutator=mutate if name.endswith(".json") else None,
    )
    atheris.Fuzz()


def changed_json(content: bytes, rng: random.Random) -> bytes | None:
    """Return a document with one value replaced, dropped, renamed or repeated; None where the bytes are no document."""
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return None
    parent: Any = [document]
    key: Any = 0
    while isinstance(parent[key], dict | list) and parent[key] and rng.random() < 0.85:
        parent = parent[key]
        key = rng.choice(list(parent)) if isinstance(parent, dict) else rng.randrange(len(parent))
    how = rng.randrange(6)
    if how == 0 and isinstance(parent, dict):
        parent[rng.choice(KEYS)] = parent.pop(key)
    elif how == 1 and isinstance(parent, list):
        parent.append(parent[key])
    elif how == 2 and parent != [document]:
        del parent[key]
    else:
        parent[key] = rng.choice(VALUES)
    return json.dumps(document).encode()


def _where(error: BaseException) -> str:
    """Return what was raised and in which line."""
    cause = error.__cause__ or error
    trace = cause.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    place = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}" if trace else ""
    return f"{place} {type(cause).__name__}"


def run(name: str, folder: Path, seconds: int) -> str:
    """Fuzz one kind of file in a process; return a line of the table."""
    command = [sys.executable, __file__, "--family", name, "--folder", str(folder), "--seconds", str(seconds)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "log.txt").open("wb") as log:
        code = subprocess.run(command, stdout=log, stderr=log, env=environment, check=False).returncode
    said = (folder / "log.txt").read_text(errors="replace")
    counts = {key: re.findall(rf"{key}:\s+(\d+)", said) for key in ("number_of_executed_units", "peak_rss_mb", "cov")}
    executed, peak, coverage = (f"{int(found[-1]):,}" if found else "?" for found in counts.values())
    findings = sorted(path.name for path in (folder / "findings").glob("*") if path.suffix != ".input")
    ended = "" if code == 0 else f", ended with {code}"
    return f"| {name} | {executed} | {coverage} | {peak} | {len(findings)}{ended} {', '.join(findings)} |"


def names() -> list[str]:
    """Return what is to be fuzzed."""
    sys.path[:0] = [str(REPOSITORY), str(REPOSITORY / "tests")]
    code = "import json, reader_families; print(json.dumps(list(reader_families.families())))"
    paths = os.pathsep.join(sys.path[:2])
    listed = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": paths}, check=True, capture_output=True
    )
    found: list[str] = json.loads(listed.stdout)
    return found


def main() -> None:
    """Fuzz what the command line names, by default everything, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--family", help="only this, in this process")
    parser.add_argument("--only", nargs="*", help="only these")
    parser.add_argument("--folder", type=Path, default=Path("/tmp/fuzzed_readers"))
    parser.add_argument("--seconds", type=int, default=120, help="for each kind of file")
    parser.add_argument("--side-by-side", type=int, default=1)
    options = parser.parse_args()
    if options.family:
        fuzz(options.family, options.folder, options.seconds)
        return
    print("| file | inputs tried | branches reached | peak MB | findings |\n|---|---|---|---|---|", flush=True)
    with ThreadPoolExecutor(options.side_by_side) as threads:
        lines = threads.map(lambda n: run(n, options.folder / n, options.seconds), options.only or names())
        for line in lines:
            print(line, flush=True)


if __name__ == "__main__":
    main()
