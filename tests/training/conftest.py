from collections.abc import Callable

import pyarrow as pa
import pytest
import spotted_hands


@pytest.fixture(scope="session")
def hand_tables() -> Callable[[int], tuple[pa.Table, pa.Table]]:
    """Return crops and labels of so many frames, right hands in even ones, left hands in odd ones."""
    return spotted_hands.hand_tables
