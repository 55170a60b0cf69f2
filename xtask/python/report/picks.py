"""Choice of method: for each wanted accuracy the cheapest setting that was measured to reach it."""

from dataclasses import dataclass

from report import docs
from report.tables import Marker, Reference, by_kind

WANTED = tuple(10.0**-n for n in range(2, 13))
"""Wanted errors, m."""

SHORT = (1e-3, 1e-6, 1e-9, 1e-11)
"""Wanted errors of the short table, m."""

RESOLVED = 3.0
"""A reference tells errors apart that are at least so many times its own."""


@dataclass(frozen=True)
class Pick:
    """The answer for one scene and one wanted accuracy."""

    wanted: float
    best: Marker | None
    """The cheapest; None if nothing measured is good enough."""
    second: Marker | None
    """The cheapest of the other methods."""
    resolved: bool
    """Whether the reference is good enough to tell."""


def pick(markers: list[Marker], reference: Reference, wanted: float) -> Pick:
    """The cheapest setting for the scene of `reference` whose error is at most `wanted`, as are those of all finer settings of its
    method: an error that is small by luck, where two errors cancel, is no recommendation."""
    here = [m for m in markers if m.scene == reference.scene]  # the error of one that ended early is infinite
    good = [m for m in here if all(f.error <= wanted for f in here if f.method == m.method and f.value <= m.value)]
    good.sort(key=lambda m: m.cost)
    best = good[0] if good else None
    second = next((m for m in good if best and m.method != best.method), None)
    return Pick(wanted, best, second, wanted >= RESOLVED * reference.own_error)


AUTOMATIC = "automatic"
"""The method that chooses the kind of its steps."""

FAIR = 1.3
"""Largest time that `automatic` is to take, in times of the best fixed method."""


def by_itself(markers: list[Marker], reference: Reference, wanted: float) -> float | None:
    """Time of `automatic` for a scene and a wanted error, over the time of the best other method; None where one of them does
    not get there, or the reference cannot tell."""
    own = pick([m for m in markers if m.method == AUTOMATIC], reference, wanted)
    fixed = pick([m for m in markers if m.method != AUTOMATIC], reference, wanted)
    return own.best.cost / fixed.best.cost if own.resolved and own.best and fixed.best else None


def ratio_table(markers: list[Marker], references: list[Reference]) -> tuple[list[str], list[list[str]]]:
    """Head and rows: scenes by wanted errors, ratios above `FAIR` in bold (of Markdown)."""
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
    """Two digits, more say nothing about a time."""
    return f"{value:.2g}" if value < 99.5 else f"{float(f'{value:.2g}'):.0f}"


def factor(microseconds_per_ms: float) -> str:
    """Simulated over wall time, two digits."""
    value = 1e3 / microseconds_per_ms
    digits = f"{float(f'{value:.2g}'):g}" if value < 10 else f"{int(float(f'{value:.2g}')):,}"
    return digits.replace(",", " ")


def power(value: float) -> str:
    """`1e-6`."""
    return f"{value:.0e}".replace("e-0", "e-")


def one_of_each_kind(references: list[Reference]) -> list[Reference]:
    """The first scene of each kind."""
    return [scenes[0] for scenes in by_kind(references).values()]


def short_table(markers: list[Marker], references: list[Reference]) -> list[str]:
    """Lines of Markdown: wanted accuracy by one scene of each kind."""
    shown = one_of_each_kind(references)
    head = ["tip error below", *(f"{r.kind}: {r.scene}" for r in shown)]
    lines = [
        [f"{power(wanted)} m", *(answer(pick(markers, reference, wanted)) for reference in shown)] for wanted in SHORT
    ]
    return docs.markdown(head, lines, left=len(head))


def sentences(markers: list[Marker], references: list[Reference]) -> list[tuple[str, str]]:
    """For people with five minutes: per kind of motion, the methods from coarse to fine, and their cost."""
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
    """The accuracies for which the same methods are the cheapest, and the span of their cost."""
    wanted, costs = [p.wanted for p in found], [p.best.cost for p in found]
    coarse, fine = power(max(wanted)), power(min(wanted))
    errors = f"of {fine} m" if coarse == fine else f"of {coarse} to {fine} m"
    low, high = cost(min(costs)), cost(max(costs))
    return f"for errors {errors} <strong>{winners}</strong>, at {low if low == high else f'{low} to {high}'} µs"
