"""Parts that a package offers in a registry below it.

A registry that named such a part itself would depend on a package above it. The package is imported
with ``smooth_operator``, and names its parts here.
"""

from __future__ import annotations

OFFERED: dict[str, dict[str, tuple[str, str]]] = {}
"""Kind of part -> name -> ``package.module:attribute`` and one line for ``--help``."""
