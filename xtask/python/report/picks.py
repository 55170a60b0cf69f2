"""Choice of method: the cheapest measured setting for each wanted accuracy."""

from dataclasses import dataclass

from report import docs
from report.tables import Marker, Reference, by_kind

WANTED = tuple(10.0**-n for n in range(2, 13))
"""Wanted errors, m."""

SHORT = (1e-3, 1e-6, 1e-9, 1e-11)
"""Wanted errors of the short table, m."""

RESOLVED = 3.0
"""A reference can judge errors that are at least this multiple of its own."""


@dataclass(frozen=True)
class Pick:
    """The answer for one scene and one wanted accuracy."""

    wanted: float
    best: Marker | None
    """The cheapest setting; None if no measured one is accurate enough."""
    second: Marker | None
    """The cheapest setting of another method."""
    resolved: bool
    """Whether the reference is accurate enough to judge."""


def pick(markers: list[Marker], reference: Reference, wanted: float) -> Pick:
    """The cheapest setting on the scene of `reference` with an error of at most `wanted`, which all finer settings of the method also
    meet: an error that is small by luck, because two errors cancel, is no recommendation."""
    here = [m for m in markers if m.scene == reference.scene]  # a run that ended early has infinite error
    good = [m for m in here if all(f.error <= wanted for f in here if f.method == m.method and f.value <= m.value)]
    good.sort(key=lambda m: m.cost)
    best = good[0] if good else None
    second = next((m for m in good if best and m.method != best.method), None)
    return Pick(wanted, best, second, wanted >= RESOLVED * reference.own_error)


AUTOMATIC = "automatic"
"""The method that chooses the kind of its steps."""

FAIR = 1.3
"""Largest allowed ratio of the time of `automatic` to the best fixed method."""


def by_itself(markers: list[Marker], reference: Reference, wanted: float) -> float | None:
    """Ratio of the time of `automatic` to the best other method, for a scene and a wanted error; None if one of them does not reach
    it or the reference is not accurate enough."""
    own = pick([m for m in markers if m.method == AUTOMATIC], reference, wanted)
    fixed = pick([m for m in markers if m.method != AUTOMATIC], reference, wanted)
    return own.best.cost / fixed.best.cost if own.resolved and own.best and fixed.best else None


def ratio_table(markers: list[Marker], references: list[Reference]) -> tuple[list[str], list[list[str]]]:
    """Head and rows: scenes by wanted errors; ratios above `FAIR` in Markdown bold."""
    judged = [r for r in references if any(m.scene == r.scene and m.method == AUTOMATIC for m in markers)]
    rows = []
    for reference in judged:
        ratios = [by_itself(markers, reference, wanted) for wanted in WANTED]
        rows.append(
            [reference.scene, *("" if r is None else f"**{r:.2f}**" if r > FAIR else f"{r:.2f}" for r in ratios)]
        )
    return ["scene", *(f"{power(wanted)} m" for wanted in WANTED)], rows


def picks(markers: list[Marker], reference: Reference) -> list[Pick]:
    """The answers for every wanted accuracy."""
    return [pick(markers, reference, wanted) for wanted in WANTED]


def answer(choice: Pick) -> str:
    """A cell of the short table."""
    if not choice.resolved:
        return "below the reference's own error"
    if choice.best is None:
        return "not reached"
    best = choice.best
    return f"{best.method}, {best.setting}: {cost(best.cost)} µs"


def cost(value: float) -> str:
    """Two digits; more would not be meaningful for a time."""
    return f"{value:.2g}" if value < 99.5 else f"{float(f'{value:.2g}'):.0f}"


def factor(microseconds_per_ms: float) -> str:
    """Ratio of simulated to wall time, two digits."""
    value = 1e3 / microseconds_per_ms
    digits = f"{float(f'{value:.2g}'):g}" if value < 10 else f"{int(float(f'{value:.2g}')):,}"
    return digits.replace(",", " ")


def power(value: float) -> str:
    """Formats a power of ten as `1e-6`."""
    return f"{value:.0e}".replace("e-0", "e-")


def one_of_each_kind(references: list[Reference]) -> list[Reference]:
    """The first scene of each kind."""
    return [scenes[0] for scenes in by_kind(references).values()]


def short_table(markers: list[Marker], references: list[Reference]) -> list[str]:
    """Lines of Markdown: wanted accuracy for one scene of each kind."""
    shown = one_of_each_kind(references)
    head = ["tip error below", *(f"{r.kind}: {r.scene}" for r in shown)]
    lines = [
        [f"{power(wanted)} m", *(answer(pick(markers, reference, wanted)) for reference in shown)] for wanted in SHORT
    ]
    return docs.markdown(head, lines, left=len(head))


def sentences(markers: list[Marker], references: list[Reference]) -> list[tuple[str, str]]:
    """Summary for quick readers: for each kind of motion, the methods from coarse to fine, and their cost."""
    result = []
    for kind, scenes in by_kind(references).items():
        found = [p for r in scenes for p in picks(markers, r) if p.resolved and p.best]
        stretches: list[tuple[str, list[Pick]]] = []
        for wanted in sorted({p.wanted for p in found}, reverse=True):
            here = [p for p in found if p.wanted == wanted]
            winners = " or ".join(dict.fromkeys(p.best.method for p in here))
            if stretches and stretches[-1][0] == winners:
                stretches[-1][1].extend(here)
            else:
                stretches.append((winners, here))
        if stretches:
            result.append((kind, "; ".join(_stretch(*stretch) for stretch in stretches)))
    return result


def _stretch(winners: str, found: list[Pick]) -> str:
    """Accuracies at which the same methods are the cheapest, and the range of their cost."""
    wanted, costs = [p.wanted for p in found], [p.best.cost for p in found]
    coarse, fine = power(max(wanted)), power(min(wanted))
    errors = f"of {fine} m" if coarse == fine else f"of {coarse} to {fine} m"
    low, high = cost(min(costs)), cost(max(costs))
    return f"for errors {errors} <strong>{winners}</strong>, at {low if low == high else f'{low} to {high}'} µs"
