"""``python3 -m slitpose.export SCENE --output DIR``: everything that a workshop needs to make a head."""

from __future__ import annotations

import sys

MIN_PYTHON = (3, 11)


def main() -> int:
    """Runs the command; errors go to standard error."""
    if sys.version_info < MIN_PYTHON:
        print(
            f"slitpose.export needs Python {MIN_PYTHON[0]}.{MIN_PYTHON[1]}; this is {sys.version.split()[0]}",
            file=sys.stderr,
        )
        return 1
    try:
        from .command import run
    except ModuleNotFoundError as error:
        print(f"slitpose.export needs {error.name}; install it with: pip install 'slitpose[cad]'", file=sys.stderr)
        return 1
    return run(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
