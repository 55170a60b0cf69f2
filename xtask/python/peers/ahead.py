"""Compares our methods with each peer at every wanted accuracy, from the rows of peers.csv."""

import re
from dataclasses import dataclass

OURS = "FiveBar "
"""Prefix of the names of our methods."""

SCENES = ("fall_90_120", "swing", "servo_friction")
"""Scenes for the comparison of errors: one with fast passages, a smooth one, and one with servos and friction."""

WANTED = tuple(10.0**-n for n in range(2, 11))
"""Errors of the tip, m."""

ENERGY_SCENE = "paper_free_fall"
"""The scene of 50 s for the comparison of energies."""

FIXED_STEP = re.compile(r"(?:h|solver\.stepSize) = (?:0\.001|1e-03)(?![\d.])")
"""In settings: fixed steps of 1 ms."""

Row = dict[str, str]


@dataclass(frozen=True)
class Answer:
    """For one accuracy: our cheapest setting, and the ratio of each peer's cheapest time to it."""

    wanted: float
    method: str
    """With its settings; empty if none of ours is accurate enough."""
    ms: float
    """Milliseconds per simulated second."""
    ratios: dict[str, float | None]
    """Ratio of the peer's time to ours; None if the peer does not reach this accuracy."""


def table(rows: list[Row], scene: str, second: int) -> list[Answer]:
    """Answers for a scene, for the error after 1 or 2 seconds. A small error by luck counts for a peer. A setting of ours counts only if all its
    more expensive settings are accurate enough as well."""
    column = f"error_{second}s_m"
    done = [r for r in rows if r["scene"] == scene and r[column] and r["ms_per_simulated_second"]]
    points = [(r["peer"], r["settings"], float(r[column]), float(r["ms_per_simulated_second"])) for r in done]
    ours = [p for p in points if p[0].startswith(OURS)]
    # Includes peers without any result, so that they are visible; excludes peers left out or without the scene's loads.
    peers = list(dict.fromkeys(r["peer"] for r in rows if r["scene"] == scene and not r["peer"].startswith(OURS)))
    answers = []
    for wanted in WANTED:
        good = [p for p in ours if all(q[2] <= wanted for q in ours if q[0] == p[0] and q[3] >= p[3])]
        if not good:
            answers.append(Answer(wanted, "", float("nan"), {}))
            continue
        name, settings, _, cost = min(good, key=lambda p: p[3])
        costs = {peer: [p[3] for p in points if p[0] == peer and p[2] <= wanted] for peer in peers}
        ratios = {peer: min(found) / cost if found else None for peer, found in costs.items()}
        answers.append(Answer(wanted, f"{name.removeprefix(OURS)}, {settings}", cost, ratios))
    return answers


def cells(answers: list[Answer]) -> list[list[str]]:
    """Head and rows: wanted error, our method, its time, then a column per peer."""
    peers = list(dict.fromkeys(peer for answer in answers for peer in answer.ratios))
    lines = [["error below", "ours", "ms/s", *peers]]
    for answer in answers:
        wanted = f"{answer.wanted:.0e} m".replace("e-0", "e-")
        if answer.method:
            lines.append([wanted, answer.method, f"{answer.ms:.2g}", *(_ratio(answer.ratios[peer]) for peer in peers)])
        else:
            lines.append([wanted, "not reached", "", *[""] * len(peers)])
    return lines


def energies(rows: list[Row]) -> list[list[str]]:
    """Head and rows: energy error over 50 s of every program at fixed steps of 1 ms, smallest first."""
    fixed = [row for row in rows if row["scene"] == ENERGY_SCENE and FIXED_STEP.search(row["settings"])]
    fixed.sort(key=lambda row: (bool(row["note"]), float(row["energy_error_mgL"] or "inf")))
    lines = [
        [
            row["peer"].removeprefix(OURS),
            row["settings"].removesuffix(", C++ by g++ -O3"),
            f"{float(row['energy_error_mgL']):.2g}".replace("e-0", "e-") if row["energy_error_mgL"] else "",
            row["note"].split(":")[0] or "50 s",
        ]
        for row in fixed
    ]
    return [["program", "settings", "largest change of the energy, mgL", "reached"], *lines]


def markdown(table: list[list[str]]) -> list[str]:
    """Lines of Markdown for a table."""
    head, *lines = table
    return [f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *lines)]


def _ratio(value: float | None) -> str:
    if value is None:
        return "not reached"
    text = f"{value:.2g}" if value < 99.5 else f"{float(f'{value:.2g}'):.0f}"
    return f"{text} ×" if value > 1 else f"{text} ×, behind"
