"""BeaconSearch: one pair of ends, one set of beacons, any number of questions about the best path between them.

Each question is answered by walks of `driftplan.planning.roadmap.beacon_walks`, under this limit and that, and by
shortening what they found as long as the exact model agrees. The same seed gives the same path unless `stop`
interfered.

*The least worst drift decides what can be kept.* A limit that its path keeps is never called out of reach, and the
shortest path that keeps it is no longer than its path; under a limit that is lower by more than `WORST_TOLERANCE` no
path is sought for the least drift at the end, and none for the least length is found within the same length. (Where
any length will do, a walk that is longer than that may be shortened to a path that is not.)
"""

from __future__ import annotations

import math

from driftplan.arrays import Floats
from driftplan.planning.bounds import least_length, least_worst_drift
from driftplan.planning.request import DEFAULT_DETOUR, Objective
from driftplan.planning.roadmap.beacon_walks import FINE, ROUNDING, WORST_TOLERANCE, BeaconWalks, with_smaller_range
from driftplan.planning.roadmap.itinerary_check import ALL_ALIVE, ItineraryCheck
from driftplan.planning.roadmap.polish import shortened
from driftplan.planning.roadmap.prices import length_of

_COARSE, _MEDIUM = 0.15, 0.05  # slack of labels as a share of the limit squared: for a path soon; see FINE
_LABELS_OF_FUSED = 5_000  # about: where a FINE search for a robot with a filter would take more, its slack is greater
_LABELS_GROW = 1.5  # with the inverse of the slack to this power: as measured with 1000 nodes
_MAX_LABELS_OF_BISECTION = 8_000  # of a search that need only find any path
_MAX_LABELS_BY_END = 6_000  # of a search for the least drift at the end, which seldom comes to an end of its own
_LEEWAY = 1.06  # times the limit, for a graph whose drift may be a little greater than the exact one
_MAX_BISECTIONS = 8
_STEP_DOWN = 0.93  # of the least limit kept so far, a finer search tries until it finds no way to keep it
_LOOSENESS = (1.05, 1.5, 3.0, math.inf)  # than the least limit on the way, when the least end drift is sought
_MAX_SHORTENING_TRIALS = 400  # of shorter paths


class BeaconSearch(BeaconWalks):
    """Paths from ``ends[0]`` to ``ends[1]`` that count on beacons; parameters and attributes as for `BeaconWalks`."""

    def best(self, minimise: Objective) -> Floats | None:
        """The best path that keeps the limit of the `Reliance`, or None."""
        limit, longest = self.reliance.max_drift, self.max_length(minimise)
        if math.isfinite(limit) and least_length(self.ends, self.noises, self.reliance.bounding, limit) > longest:
            return None  # whatever the roadmap
        if minimise == "length":
            return self.shortest_within(limit, longest)
        return (self.least_end_drift if minimise == "drift" else self.least_worst_drift)(limit, longest)

    def shortest_within(self, limit: float, longest: float, *, thorough: bool = True) -> Floats | None:
        """The shortest path on which the drift never exceeds ``limit``. A ``thorough`` search overlooks none that keeps
        it with `WORST_TOLERANCE` to spare, and takes several times as long."""
        if self._keeps(self.shortest, limit, longest):
            return self.shortest
        for within in self._spans(longest):  # what is found within a shorter one is shorter
            found = [path for path in self.known if self._keeps(path, limit, within)]
            if (path := self._short_within(limit, within)) is not None:
                found.append(path)
            if thorough and (not found or self._is_tight(limit, within, min(map(self.worst, found)))):
                steady = None if self.late() else self.least_worst_drift(limit, within)
                found += [] if steady is None else [steady]
            if found:
                return self.shorter(min(found, key=length_of), limit)
        return None

    def least_end_drift(self, limit: float, longest: float) -> Floats | None:
        """The path with the least rms at its end that keeps the limit on the way.

        The best one without a limit is looked for first, so that a limit that does not bind changes nothing.
        """
        rough = self._roughly_least_worst(longest)
        share = 1 - WORST_TOLERANCE / 2  # clear of rounding on either side
        if limit < share * self.worst(rough) and limit < share * self.worst(self._steady(longest)):
            return None
        candidates = self._paths_of_low_end_drift(rough, longest)
        best = min(candidates, key=self._end_drift)
        shorter = self.shorter(best, math.inf, self._end_drift(best))
        if self._keeps(shorter, limit, longest):
            return shorter
        candidates = [path for path in candidates if self._keeps(path, limit, longest)]
        found = self._low_end_within(limit, longest)
        candidates += [] if found is None else [found]
        for within in () if candidates else self._spans(longest):
            if not self.late() and not candidates:
                candidates = [path for path in (self.least_worst_drift(limit, within),) if path is not None]
        if not candidates:
            return None
        best = min(candidates, key=self._end_drift)
        return self.shorter(best, limit, self._end_drift(best))

    def least_worst_drift(self, limit: float, longest: float) -> Floats | None:
        """The path with the least greatest drift on the way, to within `WORST_TOLERANCE`; the shortest of those.

        None if it exceeds the limit; otherwise the limit changes nothing.
        """
        path = self._steady(longest)
        return path if self.worst(path) <= limit else None

    def any_within(self, limit: float, longest: float, slack: float, margin: float | None = None) -> Floats | None:
        """A path on which the drift never exceeds ``limit``: the first found."""
        max_labels = min(self.max_labels, _MAX_LABELS_OF_BISECTION)
        return self.best_walk(limit, longest, slack=slack, max_labels=max_labels, margin=margin)

    def _spans(self, longest: float) -> list[float]:
        """Greatest lengths to look within, one after the other: each has a roadmap of its own."""
        return sorted({min(longest, DEFAULT_DETOUR * length_of(self.shortest) * (1 + ROUNDING)), longest})

    def _is_tight(self, limit: float, longest: float, kept: float) -> bool:
        """Whether nothing is found that keeps a limit lower by `WORST_TOLERANCE`; something keeps ``kept``."""
        lower = (1 - WORST_TOLERANCE) * limit
        return kept > lower and not self.late() and self._short_within(lower, longest) is None

    def _short_within(self, limit: float, longest: float, *, soon: bool = True) -> Floats | None:
        """A short path that keeps the limit; ``soon`` where there probably is one."""
        found = self.best_walk(limit, longest, slack=_COARSE, max_labels=self.max_labels) if soon else None
        within, arrival, slack = longest, limit, FINE
        if self.reliance.estimator == "filter":
            coarse, labels = self.latest
            slack = max(FINE, coarse * (labels / _LABELS_OF_FUSED) ** (1 / _LABELS_GROW))
        if found is not None:  # beacons need not be passed closer by than the drift of such a path asks for
            within, arrival = min(longest, length_of(found)), self.worst(found)
        finer = self.best_walk(limit, within, slack=slack, max_labels=self.max_labels, arrival=arrival)
        found = found if finer is None else finer
        if found is None:  # ranges with a margin overlook readings that do harm
            held = _LEEWAY * limit
            found = self.best_walk(limit, longest, slack=slack, max_labels=self.max_labels, margin=0.0, held=held)
        return found

    def _low_end_within(self, limit: float, longest: float) -> Floats | None:
        max_labels = min(self.max_labels, _MAX_LABELS_BY_END)
        return self.best_walk(limit, longest, slack=FINE, max_labels=max_labels, by_end=True)

    def _paths_of_low_end_drift(self, rough: Floats, longest: float) -> list[Floats]:
        """Whatever arrives with little drift has mostly had little on the way, and tight limits make searches short: so
        the search is asked with ever looser limits, from the least that can be kept on."""
        paths = [rough, self.shortest]
        paths += [path for path in (self.unaided, *self.known) if length_of(path) <= longest]
        least = self.worst(rough)
        for looseness in _LOOSENESS:
            if self.late():
                break
            found = self._low_end_within(looseness * least, longest)
            paths += [] if found is None else [found]
        return paths

    def steadiest(self, longest: float) -> Floats:
        """A path with the least greatest drift: none with `WORST_TOLERANCE` less is found."""
        if longest not in self._steadiest:
            self._steadiest[longest] = self._steadier(self._roughly_least_worst(longest), longest)
        return self._steadiest[longest]

    def _steadier(self, best: Floats, longest: float) -> Floats:
        while not self.late():
            found = self._short_within((1 - WORST_TOLERANCE) * self.worst(best), longest, soon=False)
            if found is None:
                break
            best = self._bisected(found, longest, 0.0)
        return best

    def _steady(self, longest: float) -> Floats:
        """The shortest of them."""
        while longest not in self._steady_and_short:
            best = self.steadiest(longest)
            kept = self.worst(best) * (1 + ROUNDING)
            shortest = self._short_within(kept, min(longest, length_of(best)))
            path = self.shorter(best if shortest is None else shortest, kept)
            if self.late() or self.worst(path) > (1 - WORST_TOLERANCE) * self.worst(best):
                self._steady_and_short[longest] = path
            else:  # shortening made it steadier: that is the one to beat
                self._steadiest[longest] = self._steadier(path, longest)
        return self._steady_and_short[longest]

    def _roughly_least_worst(self, longest: float) -> Floats:
        """A path with nearly the least greatest drift on the way, by bisection over the limit."""
        if longest not in self._rough:
            known = [path for path in (self.unaided, *self.known) if length_of(path) <= longest]
            self._rough[longest] = self._bisected(min([self.shortest, *known], key=self.worst), longest, None)
        return self._rough[longest]

    def _bisected(self, best: Floats, longest: float, margin: float | None) -> Floats:
        high = self.worst(best)
        least = least_worst_drift(self.ends, self.noises, self.reliance.bounding, high)
        for slack, step, tolerance in ((_COARSE, 0.5, 0.05), (_MEDIUM, _STEP_DOWN, 2 * WORST_TOLERANCE)):
            low, missed = least, False
            for _ in range(_MAX_BISECTIONS):
                if high - low <= tolerance * high or self.late():
                    break
                middle = max(0.5 * (low + high), step * high) if not missed else 0.5 * (low + high)
                if low < self._widest < middle:  # who drifts farther than that finds no beacon
                    middle = self._widest
                found = self.any_within(middle, longest, slack, margin)
                if found is None:
                    low, missed = middle, True
                else:
                    best, high = found, self.worst(found)
        return best

    def _end_drift(self, path: Floats) -> float:
        return self.check.verdict(path, by_end=True).end

    def _keeps(self, path: Floats, limit: float, longest: float) -> bool:
        return length_of(path) <= longest and self.check.verdict(path, limit).worst <= limit

    def shorter(self, path: Floats, limit: float, most_at_end: float = math.inf) -> Floats:
        """The path as short as it gets while it keeps the limit and arrives with no more drift."""
        margin = 0.5 * self._margin(limit)
        nearer = tuple(with_smaller_range(beacon, margin) for beacon in self.beacons)
        cautious = self.check.relying(beacons=nearer, min_capture=0.0)  # passes well within range are captured
        for check in (cautious, self.check):
            trial = self._shorter_while(check, path, limit, most_at_end)
            verdict = self.check.verdict(trial, limit)
            if verdict.worst <= limit and verdict.end <= most_at_end * (1 + ROUNDING):
                path = trial
        return path

    def _shorter_while(self, check: ItineraryCheck, path: Floats, limit: float, most_at_end: float) -> Floats:
        """The path, as short as it gets while one check agrees."""
        trials, dead = 0, ALL_ALIVE

        def holds(trial: Floats) -> bool:
            nonlocal trials, dead
            trials += 1
            verdict = check.verdict(trial, limit, first=dead)  # whose death broke one trial mostly breaks the next
            dead = dead if verdict.worst <= limit else verdict.dead
            return verdict.worst <= limit and verdict.end <= most_at_end * (1 + ROUNDING)

        def stop() -> bool:
            self.timed_out = self.timed_out or self.stop_shortening()
            return trials > _MAX_SHORTENING_TRIALS or self.stop_shortening()

        return path if stop() or not holds(path) else shortened(path, self.space, holds, stop)
