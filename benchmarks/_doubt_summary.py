"""What became of rooms that are right and of rooms with a fault: counts over records.

A record is what `doubts.py` keeps of one room. All counts are of rooms, or of values: a value is
the absorption of one material in one band.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from scipy.stats import beta

Group = Literal["right", "measured", "fault"]


@dataclass(frozen=True)
class Raised:
    """A finding of one room, in the order in which a report shows them."""

    code: str
    is_serious: bool  # by its severity
    voids: bool  # identifiability as a whole
    sentence: str = ""


@dataclass(frozen=True)
class Record:
    """What became of one room."""

    group: Group
    name: str  # of the kind of room, or of the fault
    seed: int
    expected: tuple[str, ...] = ()  # codes that are right: no false alarms, or causes of the fault
    refused: str = ""  # the message instead of an answer
    findings: tuple[Raised, ...] = ()  # without those that only inform
    n_pairs: int = 0
    n_values: int = 0  # that the campaign does not fix
    n_identifiable: int = 0
    n_outside: int = 0  # called identifiable, and the interval misses the true value
    n_harmful: int = 0  # of those, by more than half the interval's width
    # identifiable by the rule alone, and not after what findings took back; -1: not known
    n_taken_back: int = -1
    error: float = 0.0  # median absolute one, NaN where nothing is known of the room
    chi2: tuple[float, ...] = ()
    cpu_s: float = 0.0

    @property
    def key(self) -> tuple[str, str, int]:
        """What tells rooms apart."""
        return self.group, self.name, self.seed

    def to_json(self) -> dict[str, Any]:
        """Return what `record_of` reads."""
        return asdict(self)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Codes of serious findings and of those that void, each once, serious ones first."""
        ordered = sorted(self.findings, key=lambda f: not f.is_serious)
        return tuple(dict.fromkeys(f.code for f in ordered if f.is_serious or f.voids))

    @property
    def false_alarms(self) -> tuple[str, ...]:
        """Doubts that are not expected."""
        return tuple(code for code in self.doubts if code not in self.expected)

    @property
    def is_found(self) -> bool:
        """Whether the room is refused, doubted, or its fault named by a milder finding."""
        named = any(f.code in self.expected for f in self.findings)
        return bool(self.refused or self.doubts or named)

    @property
    def is_harmless(self) -> bool:
        """Whether no value that is called identifiable is far outside of its interval."""
        return self.n_harmful == 0

    @property
    def is_named_first(self) -> bool:
        """Whether what a reader sees first names the cause; a refusal counts as it."""
        if self.refused:
            return True
        shown = self.doubts or tuple(f.code for f in self.findings if f.code in self.expected)
        return bool(shown) and shown[0] in self.expected


def record_of(stored: dict[str, Any]) -> Record:
    """Return a record from what JSON keeps of it."""
    findings = tuple(Raised(**f) for f in stored["findings"])
    lists = {k: tuple(stored[k]) for k in ("expected", "chi2")}
    return Record(**{**stored, **lists, "findings": findings})


def clopper_pearson(k: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Return the exact binomial confidence interval of k of n.

    C. J. Clopper, E. S. Pearson, "The use of confidence or fiducial limits illustrated in the case
    of the binomial", Biometrika 26, 404-413 (1934).

    Examples
    --------
    >>> low, high = clopper_pearson(0, 200)
    >>> low, round(high, 4)
    (0.0, 0.0183)
    """
    tail = 0.5 * (1.0 - level)
    low = float(beta.ppf(tail, k, n - k + 1)) if k > 0 else 0.0
    high = float(beta.ppf(1.0 - tail, k + 1, n - k)) if k < n else 1.0
    return low, high


@dataclass
class ConfusionMatrix:
    """How many rooms of each row raised each code."""

    rows: dict[str, int] = field(default_factory=dict)  # rooms by "group: name"
    counts: Counter[tuple[str, str]] = field(default_factory=Counter)

    @property
    def columns(self) -> list[str]:
        """Codes that were raised at all, the most frequent first."""
        total: Counter[str] = Counter()
        for (_, code), n in self.counts.items():
            total[code] += n
        return [code for code, _ in total.most_common()]


def confusion(records: Iterable[Record]) -> ConfusionMatrix:
    """Return rooms by what is true of them and by which doubts they raised; refusals are one."""
    matrix = ConfusionMatrix()
    for r in records:
        row = f"{r.group}: {r.name}"
        matrix.rows[row] = matrix.rows.get(row, 0) + 1
        for code in ("REFUSED",) if r.refused else r.doubts:
            matrix.counts[row, code] += 1
    return matrix


def matrix_text(matrix: ConfusionMatrix) -> str:
    """Return the matrix as a table, codes numbered and named below it."""
    columns = matrix.columns
    width = max((len(row) for row in matrix.rows), default=0)
    numbers = " ".join(f"{i:>3}" for i in range(1, len(columns) + 1))
    lines = [f"{'':<{width}} rooms {numbers}"]
    for row, n in matrix.rows.items():
        cells = " ".join(f"{matrix.counts[row, code] or '.':>3}" for code in columns)
        lines.append(f"{row:<{width}} {n:5d} {cells}")
    lines += [f"{i:>3} {code}" for i, code in enumerate(columns, start=1)]
    return "\n".join(lines)


def false_alarm_text(records: Sequence[Record], codes: Iterable[str]) -> str:
    """Return for each code how many right rooms raised it falsely, with a 95 % interval.

    Rooms in which a code is expected, or that were refused, count in no line of that code.
    """
    lines = [f"{'code':<32} rooms false   rate   95 %            kinds of room"]
    rows = []
    for code in codes:
        own = [r for r in records if code not in r.expected and not r.refused]
        raised = [r.name for r in own if code in r.doubts]
        rows.append((len(raised), code, len(own), Counter(raised)))
    for k, code, n, kinds in sorted(rows, key=lambda row: (-row[0], row[1])):
        if n:
            low, high = clopper_pearson(k, n)
            named = ", ".join(f"{kind} {m}" for kind, m in kinds.most_common())
            lines.append(f"{code:<32} {n:5d} {k:5d} {k / n:7.3f} {low:7.4f} {high:7.4f}  {named}")
    return "\n".join(lines)


def values_text(records: Sequence[Record]) -> str:
    """Return what became of the values of right rooms."""
    own = [r for r in records if not r.refused]
    total = {
        key: sum(getattr(r, f"n_{key}") for r in own)
        for key in ("values", "identifiable", "outside", "harmful")
    }
    refused = len(records) - len(own)
    alarmed = [r for r in own if any(f.voids and f.code not in r.expected for f in r.findings)]
    lines = [
        f"{len(records)} rooms, {refused} refused; {total['values']} values,"
        f" {total['identifiable']} identifiable, {total['outside']} of them outside their interval,"
        f" {total['harmful']} by more than half its width",
        f"{len(alarmed)} rooms voided by a false alarm, with"
        f" {sum(r.n_values for r in alarmed)} values",
    ]
    known = [r for r in alarmed if r.n_taken_back >= 0]
    if known:
        lost = sum(r.n_taken_back for r in known)
        lines.append(f"values identifiable by the rule and lost to false alarms: {lost}")
    return "\n".join(lines)


def faults_text(records: Sequence[Record]) -> str:
    """Return for each fault the share found, harmless, either, and named first."""
    names = list(dict.fromkeys(r.name for r in records))
    width = max((len(name) for name in names), default=0)
    head = ("rooms", "refus", "found", "harml", "eithr", "named", "ident", "outs", "harmf")
    lines = [f"{'fault':<{width}} " + " ".join(f"{h:>5}" for h in head)]
    for name in [*names, "all"]:
        own = [r for r in records if name in (r.name, "all")]
        lines.append(f"{name:<{width}} " + " ".join(f"{cell:>5}" for cell in _fault_cells(own)))
    return "\n".join(lines)


def _fault_cells(own: Sequence[Record]) -> list[str]:
    n = len(own)
    nameable = [r for r in own if r.is_found and r.expected]
    named = sum(r.is_named_first for r in nameable)
    return [
        str(n),
        str(sum(bool(r.refused) for r in own)),
        f"{sum(r.is_found for r in own) / n:.2f}",
        f"{sum(r.is_harmless for r in own) / n:.2f}",
        f"{sum(r.is_found or r.is_harmless for r in own) / n:.2f}",
        f"{named / len(nameable):.2f}" if nameable else "-",
        *(str(sum(getattr(r, k) for r in own)) for k in ("n_identifiable", "n_outside")),
        str(sum(r.n_harmful for r in own)),
    ]


def summary(records: Sequence[Record], codes: Iterable[str]) -> str:
    """Return all tables.

    `codes`: those whose false alarms are counted.
    """
    codes = list(codes)
    groups: dict[Group, list[Record]] = {"right": [], "measured": [], "fault": []}
    for r in records:
        groups[r.group].append(r)
    parts = ["Confusion matrix: rooms that raised a code", matrix_text(confusion(records))]
    if groups["right"]:
        parts += ["False alarms in simulated right rooms"]
        parts += [false_alarm_text(groups["right"], codes), values_text(groups["right"])]
    if groups["measured"]:
        parts += ["False alarms in measured rooms"]
        raised = {code for r in groups["measured"] for code in r.false_alarms}
        parts += [false_alarm_text(groups["measured"], sorted(raised))]
    if groups["fault"]:
        parts += [
            "Faults: shares of rooms; named: the right cause first, of those found",
            faults_text(groups["fault"]),
        ]
    seconds = sum(r.cpu_s for r in records)
    parts += [f"{len(records)} rooms, {seconds / 60.0:.1f} CPU min, "
              f"{seconds / max(len(records), 1):.1f} CPU s a room"]  # fmt: skip
    return "\n\n".join(parts)
