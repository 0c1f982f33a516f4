"""Why a search ended."""

from __future__ import annotations

from enum import Enum


class Status(Enum):
    """Why a search ended; the value is a sentence for people."""

    OPTIMAL = "Proven optimal."
    INFEASIBLE = "Proven that there is none."
    GOOD_ENOUGH = "Good enough for what was asked; not proven optimal."
    LOCAL_OPTIMUM = "No neighbour leads to a cheaper design: neither other routes nor fewer beacons pay."
    SEARCH_DONE = "Search done: the best route of its roadmap, up to the tolerances of the search."
    BOUND_REACHED = "Done: within 1 % of what no route can beat."
    NOTHING_GAINED = "Done: further batches of the roadmap brought next to nothing."
    BATCHES_DONE = "All batches done: the best path of the roadmap so far."
    ITERATIONS_DONE = "All iterations done: the best path so far."
    LABELS_DONE = "As many partial routes kept as may be: the best route so far."
    ROUNDS_DONE = "All rounds done: the best design so far."
    TIME_LIMIT = "Time limit reached: the best so far."
