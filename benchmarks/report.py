"""How long does the report of a run take, and how large is it?

    python benchmarks/report.py RESULTS...

Makes the report of each folder of results anew, three times, into a temporary place; prints the shortest time and the
size.
The project asks for less than 10 s and 3 MB for an hour.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import shipgrid as sg


def main() -> None:
    """Measure every folder that is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", nargs="+", type=Path)
    for folder in parser.parse_args().results:
        with sg.open_results(folder) as run, tempfile.TemporaryDirectory() as place:
            times = []
            for _ in range(3):
                began = time.perf_counter()
                page = run.report(Path(place) / "report.html")
                times.append(time.perf_counter() - began)
            simulated = run.summary["simulated_s"]
            print(
                f"{folder}: {simulated:g} s simulated, report in {min(times):.2f} s, {page.stat().st_size / 1e6:.2f} MB"
            )


if __name__ == "__main__":
    main()
