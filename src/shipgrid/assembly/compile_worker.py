"""A process that compiles: `python -m shipgrid.assembly.compile_worker`.

It reads what to compile from its standard input, a name by `code_store.job_of` on each line, and answers each with a
line when the object is in the store.
"""

from __future__ import annotations

import sys

from shipgrid.assembly.code_store import do_job


def main() -> None:
    """Do jobs until there are no more."""
    for line in sys.stdin:
        try:
            do_job(line.strip())
            answer = "done"
        except Exception as wrong:  # who asked compiles it itself, and meets it again
            answer = f"failed: {type(wrong).__name__}"
        sys.stdout.write(f"{answer}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
