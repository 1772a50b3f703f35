"""What people see of a plant: public signals, waveforms, and codes whose changes are events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class PublicSignal:
    """A signal people see: name, where it comes from, unit, meaning, recorder group."""

    name: str
    source: str
    unit: str
    description: str
    group: str


@dataclass(frozen=True)
class Waveform:
    """A quantity that is recorded in windows only, at every step: a weighted sum of signals.

    Attributes
    ----------
    name : str
        Public name.
    terms : tuple of (str, float)
        Paths of the signals, and what each is multiplied by.
    unit, description : str
    mean : bool
        Whether its value is the mean over the step that ends at each instant, and not the value at the instant.
    carrier : float
        Frequency [Hz] of the carrier that shapes it; 0 without one.
    """

    name: str
    terms: tuple[tuple[str, float], ...]
    unit: str
    description: str
    mean: bool = False
    carrier: float = 0.0


@dataclass(frozen=True)
class Watched:
    """A code signal whose changes are events, with the texts of its codes."""

    owner: str
    source: str
    texts: Mapping[int, str]
    refusal: bool = False


def terms_of(public: PublicSignal | Waveform) -> tuple[tuple[str, float], ...]:
    """What a public quantity is the weighted sum of: paths, and what each is multiplied by.

    Parameters
    ----------
    public : PublicSignal or Waveform
    """
    return public.terms if isinstance(public, Waveform) else ((public.source, 1.0),)
