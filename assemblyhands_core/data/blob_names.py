"""Names of files that belong to a result, from names that users gave."""

import hashlib
import re

_UNSAFE = re.compile(r"[^A-Za-z0-9_-]")


def blob_name(name: str, suffix: str) -> str:
    """Return a file name for something called ``name``; other names give other files, on any file system.

    Args:
        name: what a user calls it, for example a camera; any characters.
        suffix: ending with its dot, for example ``.mp4``.
    """
    safe = _UNSAFE.sub("_", name)
    is_same = safe == name and name != ""
    return f"{safe}{suffix}" if is_same else f"{safe}-{hashlib.sha256(name.encode()).hexdigest()[:8]}{suffix}"
