"""Find what is damaged in a workspace: entries of the store, what may have been made from them, laid-out recordings."""

from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from assemblyhands_core.data.digests import digest_file
from assemblyhands_core.data.entry_records import RECORD, Record
from assemblyhands_core.data.integrity import Digest, Flaw, InodeDigests, digests_of_blob_tables, examine
from assemblyhands_core.data.store import Store

_LISTING: Final = ".sha256"


@dataclass(frozen=True)
class Damage:
    """What is wrong with an entry of the store, or with a recording, named by the list of its files."""

    place: Path
    flaws: Sequence[Flaw]

    @property
    def is_certain(self) -> bool:
        """Whether it is damaged, rather than not to be looked at now."""
        return any(flaw.is_damage for flaw in self.flaws)

    @property
    def is_recording(self) -> bool:
        """Whether it is a recording, else an entry of the store."""
        return self.place.suffix == _LISTING

    @property
    def is_silent(self) -> bool:
        """Whether a stage may have read damaged bytes without noticing."""
        return any(flaw.is_silent for flaw in self.flaws)


@dataclass(frozen=True)
class Check:
    """One thing to look at: where it is, how large it is, and what finds its flaws."""

    place: Path
    num_bytes: int
    find_flaws: Callable[[Path, Digest], list[Flaw]]


def checks(store: Store, studio: Path) -> list[Check]:
    """Return all that there is to look at: the store's entries, then the recordings that the studio delivered."""
    listings = sorted((studio / "delivered").glob(f"*{_LISTING}"))
    return [
        *(Check(entry, _num_bytes(entry.glob("*")), examine) for entry in store.entries()),
        *(Check(listing, _num_bytes(_listed(listing)), examine_recording) for listing in listings),
    ]


def find_damage(found: Sequence[Check], num_threads: int, advance: Callable[[int], None]) -> Iterator[Damage]:
    """Yield what is damaged, as it is found; ``advance`` is told how many bytes more were looked at.

    What seems damaged is looked at once more by itself: another run may just have made it anew, a server may have been
    away for a moment.
    """
    digest = InodeDigests()
    pool = ThreadPoolExecutor(num_threads)
    try:
        under_way = {pool.submit(_flaws, check, digest): check for check in found}
        for done in as_completed(under_way):
            check = under_way.pop(done)
            if flaws := done.result():
                yield Damage(check.place, flaws)
            advance(check.num_bytes)
    finally:
        pool.shutdown(cancel_futures=True)


def find_suspects(store: Store, damages: Collection[Damage]) -> Iterator[Damage]:
    """Yield the entries that were made from damaged files, perhaps after these were damaged."""
    sources: dict[str, Path] = {}
    for damage in (damage for damage in damages if damage.is_silent and (damage.place / RECORD).is_file()):
        with suppress(OSError, ValueError):
            sources |= dict.fromkeys(digests_of_blob_tables(damage.place), damage.place)
    known = {damage.place for damage in damages}
    for entry in (entry for entry in store.entries() if sources and entry not in known):
        if read := sources.keys() & _digests_read(entry):
            source = sources[min(read)]
            reason = f"it was made from {source.parent.name}/{source.name}, perhaps when that was damaged already"
            yield Damage(entry, [Flaw(entry, reason)])


def examine_recording(listing: Path, digest: Digest = digest_file) -> list[Flaw]:
    """Return what is wrong with the files of a recording that the studio delivered."""
    flaws = []
    for path, wanted in _listed_digests(listing).items():
        try:
            if digest(path) != wanted:
                flaws.append(Flaw(path, f"its contents have another sha256 than {listing} says"))
        except FileNotFoundError:
            flaws.append(Flaw(path, "it is gone"))
        except OSError as error:
            flaws.append(Flaw(path, f"it cannot be read ({error.strerror or error})", is_damage=False))
    return flaws if listing.is_file() else []


def _flaws(check: Check, digest: Digest) -> list[Flaw]:
    return check.find_flaws(check.place, digest) and check.find_flaws(check.place, digest_file)


def _digests_read(entry: Path) -> set[str]:
    """Return the digests of what an entry was made from, of the whole table where it read a slice."""
    with suppress(OSError, ValueError, TypeError, KeyError, AttributeError):
        inputs = Record.from_json((entry / RECORD).read_text(encoding="utf-8")).parts["inputs"]
        return {digest.partition("#")[0] for digests in inputs.values() for digest in digests}
    return set()


def _listed_digests(listing: Path) -> dict[Path, str]:
    """Return the sha256 of a recording's files; none if its list vanished meanwhile."""
    with suppress(FileNotFoundError):
        lines = [line.partition("  ") for line in listing.read_text(encoding="utf-8").splitlines()[1:]]
        return {listing.parents[1] / path: digest for digest, _, path in lines}
    return {}


def _listed(listing: Path) -> Iterator[Path]:
    return iter(_listed_digests(listing))


def _num_bytes(files: Iterator[Path]) -> int:
    """Return the size of files and of what links point to, as far as they are there."""
    total = 0
    for path in files:
        with suppress(OSError):
            total += path.stat().st_size
    return total
