"""Takes that several test files look at, made once."""

import numpy as np
import pytest

from assemblyhands_core.synthetic.bench import Bench
from assemblyhands_core.synthetic.layout import lay_out
from assemblyhands_core.synthetic.person import Subject
from assemblyhands_core.synthetic.take import State, Take
from assemblyhands_core.synthetic.toys import SetKind, draw_set

FRAME_RATE_HZ = 30.0


@pytest.fixture(scope="session")
def take() -> Take:
    """Some seconds with a vehicle; all checks below look at every frame of it."""
    return Take.from_seed(3, 6, 14.0)


@pytest.fixture(scope="session")
def states(take: Take) -> list[State]:
    """The take at 30 Hz."""
    return [take.state_at(n / FRAME_RATE_HZ) for n in range(int(take.duration_s * FRAME_RATE_HZ))]


@pytest.fixture(scope="session")
def screwing_take() -> Take:
    """More seconds with a vehicle, with what the other take lacks."""
    return Take.from_seed(12, 29, 16.0)


@pytest.fixture(scope="session")
def desk_take() -> Take:
    """Some seconds at a desk."""
    return Take.from_seed(5, 8, 12.0, "desktop")


def bench_with(kind: SetKind, seed: int, is_building: bool) -> Bench:
    """Return a laid-out bench whose workpiece is held."""
    for attempt in range(seed, seed + 20):
        rng = np.random.default_rng(attempt)
        bench = Bench(Subject.from_seed(1), draw_set(kind, rng), rng, tempo=1.0)
        lay_out(bench, is_building)
        if bench.held:
            return bench
    raise AssertionError("no draw out of twenty begins with the workpiece in the hand")


@pytest.fixture
def bench() -> Bench:
    """A vehicle of which much is still on the table."""
    return bench_with("assembly", 1, is_building=True)


@pytest.fixture
def built_bench() -> Bench:
    """A vehicle that is mostly assembled."""
    return bench_with("assembly", 40, is_building=False)
