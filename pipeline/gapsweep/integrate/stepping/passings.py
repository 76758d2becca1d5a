"""Wall crossings within the steps of laws whose contacts are not located."""

from gapsweep.integrate.jit import chosen_by_type, internal
from gapsweep.integrate.lanes.parameters import CENTRE, N_PARAMETERS, RANGE
from gapsweep.integrate.vectors import lowest_bit

from .record import CONTACTS, TIME, load_series, write_row
from .roots import SIMPLE, first_exit, isolate


def count_passings(layout, among, run):
    """Correct the counts of lanes whose last step may have passed a wall and come back."""
    raise NotImplementedError("compiled code only")


def record_passings(layout, among, run):
    """Record the wall crossings of lanes within their last steps, in the order of time."""
    raise NotImplementedError("compiled code only")


@chosen_by_type(count_passings)
def _chosen_count(layout, among, run):
    one = _none if layout.layout.is_located else _count_all
    return lambda layout, among, run: one(among, run)


@chosen_by_type(record_passings)
def _chosen_record(layout, among, run):
    one = _none if layout.layout.is_located else _record_all
    return lambda layout, among, run: one(among, run)


@internal
def _none(among, run):
    """Do nothing: the loop itself counts and records located contacts."""


@internal
def _count_all(among, run):
    while among != 0:
        k = lowest_bit(among)
        among &= among - 1
        _count(run.at[0], run, k)


@internal
def _record_all(among, run):
    while among != 0 and run.contacts:
        k = lowest_bit(among)
        among &= among - 1
        _record(run.at[0], run, k)


@internal
def _passings(at, run, k, end, wall, outward):
    """Find the times, into `work.roots`, at which the gap `work.series` passes a wall in a step.

    A motion that starts on the wall and moves outwards passes it too, but without a time.

    Returns
    -------
    n_times, n_by_ends, heads_out : int
        Number of times; number of crossings between both ends of the step, which steps count; 1 if
        the motion starts on the wall and moves outwards.
    """
    work, h = run.work, run.lanes[at.step, k]
    series, gap = work.series, work.reduced
    degree, skipped, is_on = at.order, 0, series[0] == wall
    if is_on:
        skipped = 1
        while skipped < degree and series[skipped] == 0.0:
            skipped += 1
    for n in range(skipped, degree + 1):
        gap[n - skipped] = series[n]
    if not is_on:
        gap[0] = series[0] - wall
    was, is_ = outward * (series[0] - wall) > 0.0, outward * (end - wall) > 0.0
    heads_out = int(is_on and outward * gap[0] > 0.0)
    if gap[0] == 0.0 or h <= 0.0:
        return 0, int(was != is_), heads_out
    found = isolate(degree - skipped, h, (end - wall) / h**skipped, -1.0, work)
    kept = 0
    for i in range(found):
        if work.multiplicity[i] == SIMPLE:
            work.roots[kept] = work.roots[i]
            kept += 1
    return kept, int(was != is_), heads_out


@internal
def _count(at, run, k):
    lanes, work = run.lanes, run.work
    for contact in range(at.contacts):
        load_series(run.coefficients, (at.first_gap + contact) * at.n_terms, k, work.series)
        end = lanes[at.gap_end + contact, k]
        for side in (1.0, -1.0):
            wall = lanes[(at.upper if side > 0.0 else at.lower) + contact, k]
            n_times, n_by_ends, heads_out = _passings(at, run, k, end, wall, side)
            lanes[at.n_contacts, k] += n_times + heads_out - n_by_ends
        law = at.law + contact * N_PARAMETERS
        centre, reach = lanes[law + CENTRE, k], lanes[law + RANGE, k]
        if reach > 0.0:
            h, lo, hi = lanes[at.step, k], centre - reach, centre + reach
            _, side = first_exit(h, lo, hi, end, work)
            lanes[at.out_of_range, k] = max(lanes[at.out_of_range, k], abs(side))


@internal
def _record(at, run, k):
    lanes, work, rows = run.lanes, run.work, run.logs[CONTACTS]
    begun = lanes[at.cycle_0, k] + lanes[at.tau_0, k] - lanes[at.event_clock, k]
    for contact in range(at.contacts):
        load_series(run.coefficients, (at.first_gap + contact) * at.n_terms, k, work.series)
        end, first = lanes[at.gap_end + contact, k], run.fill[CONTACTS]
        for side in (1.0, -1.0):
            wall = lanes[(at.upper if side > 0.0 else at.lower) + contact, k]
            n_times, _, _ = _passings(at, run, k, end, wall, side)
            for i in range(n_times):
                if work.roots[i] >= -begun * lanes[at.period, k]:
                    write_row(run, CONTACTS, k, lanes[at.start_time, k] + work.roots[i], contact)
        # Sort the crossings of both walls by time.
        for i in range(first + 1, run.fill[CONTACTS]):
            j = i
            while j > first and rows[j - 1, TIME] > rows[j, TIME]:
                for column in range(rows.shape[1]):
                    rows[j - 1, column], rows[j, column] = rows[j, column], rows[j - 1, column]
                j -= 1
