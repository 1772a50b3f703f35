"""Prints the tables of docs/verification.md: `PYTHONPATH=tests python -m verification.gallery_tables`."""

from __future__ import annotations

from verification.gallery import reference
from verification.test_gallery import SIGNALS, STEPS, band, deviation, figures


def against_ngspice() -> None:
    """Every figure of every circuit at 30 us and 3 us."""
    print("| circuit | figure | ngspice | 30 us | 3 us | band |\n| --- | --- | --- | --- | --- | --- |")
    for name, step in STEPS.items():
        for key, value in reference(name).items():
            ours = [figures(name, h)[key] for h in (30e-6, 3e-6)]
            print(f"| {name} | {key} | {value:.6g} | {ours[0]:.6g} | {ours[1]:.6g} | {band(key, value, step):.2g} |")


def against_one_microsecond() -> None:
    """Deviations at 30, 10 and 3 us."""
    print("| circuit | signal | 30 us | 10 us | 3 us |\n| --- | --- | --- | --- | --- |")
    for name, signals in SIGNALS.items():
        for signal in signals:
            print(
                f"| {name} | `{signal}` | "
                + " | ".join(f"{deviation(name, signal, h):.1e}" for h in (30e-6, 10e-6, 3e-6)),
                "|",
            )


if __name__ == "__main__":
    against_ngspice()
    against_one_microsecond()
