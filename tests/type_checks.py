"""How tests check the types and shapes that the code states: by beartype, which ``conftest.py`` hooks into imports."""

from typing import Self

import beartype

# An int passes for a float, as it does for mypy. ``Self`` passes anything: methods are checked one by one, so that
# beartype does not see their class.
check = beartype.beartype(
    conf=beartype.BeartypeConf(is_pep484_tower=True, hint_overrides=beartype.FrozenDict({Self: object}))
)
