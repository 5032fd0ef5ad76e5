"""The version of what the simulator draws."""

from typing import Final

SIMULATOR_VERSION: Final = 2
"""Raised whenever takes or pictures change, which `tests/synthetic/test_version.py` notices: all is made anew."""
