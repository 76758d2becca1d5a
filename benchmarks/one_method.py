"""What a contact law costs with one method, and what restarts at contacts cost.

    python benchmarks/one_method.py [--rounds 9] [--cpu 0]

Short motions (5 forcing periods from +0.4 mm, 24 frequencies) of the paper's soft and hard contact.
Costs are processor time and right-hand sides over those of the exact law, in one process, all
contenders in turn, round by round: the median over rounds, and its range.

1. Located and kept: the exact law, every contact located on the step's dense output, the step cut
   there and the next one begun with its step size, against a restart at every contact. In the
   compiled engine (`controller="ode45"`); with `scipy.integrate.RK45`, in one loop for both; and
   `solve_ivp` with terminal events and restarts against that loop.
2. Three costs of the other laws: (a) by the Dormand-Prince pair of the compiled engine, over the
   exact law located and kept; (b) by this engine's default for each law; (c) by `solve_ivp`, the
   exact law with terminal events and restarts.
3. Accuracy by the contact mode: how many times location with a restart makes the error of
   `scipy.integrate.RK45` in the fourth forcing period smaller, with the force as one expression of
   the displacement and with the force of one contact mode in every step. No times.
"""

import argparse
import math
import os
import time

import numpy as np
from scipy.integrate import RK45, solve_ivp
from scipy.optimize import brentq

import gapsweep as gs
from gapsweep.integrate.problem import Models, Problems, Solver
from gapsweep.integrate.simulate import prepared

OSCILLATOR, N_PERIODS, X_0 = gs.systems.paper_oscillator(), 5, 4e-4
OMEGA = np.linspace(8.0, 20.0, 24)
N_COMPARED = 4  # periods after which accuracy is compared
SCENES = {"soft 0.4/0.4": (1.4e4, gs.Gap(4e-4, 4e-4)), "hard 0/0.8": (1.4e6, gs.Gap(0.0, 8e-4))}
LAWS = {
    "soft 0.4/0.4": "piecewise-noevents tanh-1e4 arctan-1e4 logarctan-1e4 poly-13 ratpoly-5/3",
    "hard 0/0.8": "piecewise-noevents tanh-1e6 arctan-1e6 logarctan-1e6 poly-21 ratpoly-5/5",
}
TOLERANCES = ((1e-4, 1e-7), (1e-6, 1e-9))
N_COPIES = 32  # of every frequency, so that a call of the compiled engine takes milliseconds


# ---- The compiled engine ----------------------------------------------------------------------


def compiled(law, tolerances, **options):
    """A function that runs all motions: their ends and right-hand sides."""
    omega = np.repeat(OMEGA, N_COPIES)
    n = len(omega)
    models = Models.of([OSCILLATOR] * n, [(law,)] * n, omega)
    integrate = prepared(models, Solver.of("compiled", *tolerances, **options))
    problems = Problems(
        which=np.arange(n),
        start=np.tile([X_0, 0.0], (n, 1)),
        t_0=np.zeros(n),
        t_end=N_PERIODS / omega,
        record_from=np.full(n, math.inf),
    )

    def run():
        found = integrate(problems)
        assert not found.status.any(), law
        return found.state[::N_COPIES], found.nfev.sum() / N_COPIES

    return run


# ---- scipy ------------------------------------------------------------------------------------


def smooth_force(law):
    """The force of a law as plain Python, as a user would write it."""
    if isinstance(law, gs.Polynomial | gs.RationalPolynomial):
        return fitted_force(law)
    stiffness, low, high = law.K_c, *law.walls
    if isinstance(law, gs.Piecewise):
        return lambda x: stiffness * ((x - high) if x > high else (x - low) if x < low else 0.0)
    if isinstance(law, gs.LogArctan):
        gamma, constant = law.gamma, 0.0

        def force(x):
            a, b = x - low, x - high
            logarithm = math.log((1.0 + (gamma * a) ** 2) / (1.0 + (gamma * b) ** 2))
            terms = b * math.atan(gamma * b) - a * math.atan(gamma * a) + logarithm / (2.0 * gamma)
            return stiffness * (x + (terms + constant) / math.pi)

        constant = -math.pi / stiffness * force(0.0)
        return force
    epsilon, turn = law.epsilon, 2.0 / math.pi
    step = math.tanh if isinstance(law, gs.Tanh) else lambda z: turn * math.atan(z)
    return lambda x: (
        0.5 * stiffness * (x - low) * (1.0 - step(epsilon * (x - low)))
        + 0.5 * stiffness * (x - high) * (1.0 + step(epsilon * (x - high)))
    )


def fitted_force(law):
    """A polynomial in powers of x, or the quotient of two."""
    is_rational = isinstance(law, gs.RationalPolynomial)
    series = [np.polynomial.chebyshev.cheb2poly(c).tolist()[::-1] for c in law.coefficients]

    def value(coefficients, z):
        total = 0.0
        for c in coefficients:
            total = total * z + c
        return total

    if is_rational:
        return lambda x: value(series[0], x / law.fit_range) / value(series[1], x / law.fit_range)
    return lambda x: value(series[0], x / law.fit_range)


def right_side(force, omega, count):
    o, w = OSCILLATOR, 2.0 * math.pi * omega
    stiffness, damping, cubic = o.omega_n_rad**2, 2.0 * o.decay_rate, o.alpha / o.mass
    push, inverse = o.forcing / o.mass, 1.0 / o.mass

    def f(t, y):
        count[0] += 1
        x, v = y.item(0), y.item(1)
        spring = x * (stiffness + cubic * x * x) + inverse * force(x)
        return np.array((v, push * math.cos(w * t) - damping * v - spring))

    return f


def located(f, t_end, y, tolerances, walls, *, restart):
    """scipy's RK45, every contact located on its dense output; restarted there, or not."""
    options = dict(zip(("rtol", "atol"), tolerances, strict=True))
    s = RK45(f, 0.0, y, t_end, **options)
    while s.status == "running":
        x, t = s.y[0], s.t
        s.step()
        hit = [wall for wall in walls if (x - wall) * (s.y[0] - wall) < 0.0]
        if not hit:
            continue
        t, y = first_contact(s.dense_output(), t, s.t, hit)
        if restart:
            s = RK45(f, t, y, t_end, **options)
        else:
            h = s.h_abs
            s.t, s.y, s.f, s.h_abs, s.status = t, y, f(t, y), h, "running"
    return s.y


def first_contact(dense, t_0, t_1, walls):
    """Time and state at the first of some walls that are passed between two times."""

    def distance(t, wall):
        return dense(t)[0] - wall

    t, wall = min((brentq(distance, t_0, t_1, (wall,)), wall) for wall in walls)
    y = dense(t)
    y[0] = wall
    return t, y


def terminal(f, t_end, y, tolerances, walls):
    """`solve_ivp` with terminal events, restarted at every contact."""
    t, options = 0.0, dict(zip(("rtol", "atol"), tolerances, strict=True))
    # The mode says which wall is passed next, and in which direction.
    low, high = walls
    mode = 0

    def event(wall, direction):
        def distance(t, y):
            return y[0] - wall

        distance.terminal, distance.direction = True, direction
        return distance

    events = {0: [event(low, -1), event(high, 1)], 1: [event(high, -1)], -1: [event(low, 1)]}
    if y[0] > high or y[0] < low:
        mode = 1 if y[0] > high else -1
    while t < t_end:
        solution = solve_ivp(f, (t, t_end), y, events=events[mode], **options)
        t, y = solution.t[-1], solution.y[:, -1]
        if solution.status != 1:
            return y
        y[0] = low if mode == -1 or (mode == 0 and solution.t_events[0].size) else high
        mode = 0 if mode else (-1 if y[0] == low else 1)
    return y


def plain(f, t_end, y, tolerances, _):
    options = dict(zip(("rtol", "atol"), tolerances, strict=True))
    return solve_ivp(f, (0.0, t_end), y, **options).y[:, -1]


def scipys(law, tolerances, method, **options):
    force = smooth_force(law)

    def run():
        count, ends = [0], []
        for omega in OMEGA.tolist():
            f = right_side(force, omega, count)
            y = np.array([X_0, 0.0])
            ends.append(method(f, N_PERIODS / omega, y, tolerances, law.walls, **options))
        return np.array(ends), count[0]

    return run


# ---- Accuracy by the contact mode --------------------------------------------------------------


def fourth_period(omega, x_0, times, *, locate, by_mode):
    """Displacements at some times by RK45 at the paper's tolerances, hard contact 0/0.8 mm."""
    stiffness, gap = SCENES["hard 0/0.8"]
    walls = (-gap.j_1, gap.j_2)

    def mode_at(x):
        return -1 if x < walls[0] else 1 if x > walls[1] else 0

    t, y, mode, found = 0.0, np.array([x_0, 0.0]), 0, []
    while t < N_COMPARED / omega:

        def force(x, fixed=mode):
            here = fixed if by_mode else mode_at(x)
            return stiffness * (x - walls[here > 0]) if here else 0.0

        f = right_side(force, omega, [0])
        s = RK45(f, t, y, N_COMPARED / omega, rtol=1e-4, atol=1e-7)
        hit = []
        while s.status == "running" and not hit:
            t, x = s.t, s.y[0]
            s.step()
            dense = s.dense_output()
            hit = [w for w in walls if locate and (x - w) * (s.y[0] - w) < 0.0]
            end = first_contact(dense, t, s.t, hit) if hit else (s.t, s.y)
            found += [dense(u)[0] for u in times if t < u <= end[0]]
        t, y = end
        if hit:  # leaving the wall inwards is free flight
            mode = (
                0 if y[1] * (1 if y[0] == walls[1] else -1) < 0.0 else mode_at(y[0] + 1e-9 * y[1])
            )
    return np.array(found)


def modes():
    row("x_0", "force as one expression", "force by mode")
    row(*["---"] * 3)
    law = gs.Piecewise(*SCENES["hard 0/0.8"])
    for x_0 in (0.0, X_0):
        errors = []
        for omega in np.arange(2.5, 30.0, 0.5).tolist():
            times = np.linspace(3.02 / omega, 3.98 / omega, 40)
            options = {"t_end": N_COMPARED / omega, "rtol": 1e-12, "atol": 1e-15}
            exact = gs.simulate(OSCILLATOR, law, omega, x_0, 0.0, dense_output=True, **options)
            ways = ((False, False), (True, False), (True, True))
            motions = [fourth_period(omega, x_0, times, locate=a, by_mode=b) for a, b in ways]
            errors.append([np.sqrt(np.mean((x - exact.sample(times)[0]) ** 2)) for x in motions])
        none, written, mode = np.median(errors, axis=0)
        row(f"{x_0:g} m", f"{none / written:.1f}", f"{none / mode:.0f}")


# ---- Tables -----------------------------------------------------------------------------------


def measured(contenders, rounds):
    """Of every contender: ends, right-hand sides, and its processor times [s] in all rounds."""
    found = {name: (*run(), []) for name, run in contenders.items()}  # compiles, warms up
    for _ in range(rounds):
        for name, run in contenders.items():
            begin = time.process_time()
            run()
            found[name][2].append(time.process_time() - begin)
    return found


def ratio(times, others):
    """Median over rounds of a ratio of times, and its range."""
    each = np.divide(times, others)
    return f"{np.median(each):.2f} [{each.min():.2f}, {each.max():.2f}]"


def row(*cells):
    print("|", " | ".join(cells), "|", flush=True)


def restarts(rounds):
    row("scene", "rtol", "method", "RHS", "time", "median error, kept and restarted")
    row(*["---"] * 6)
    for scene, contact in SCENES.items():
        law = gs.Piecewise(*contact)
        truth, _ = compiled(law, (1e-12, 1e-15))()
        for tolerances in TOLERANCES:
            contenders = {
                (way, restart): make(law, tolerances, restart=restart, **options)
                for way, make, options in (
                    ("compiled", compiled, {"controller": "ode45"}),
                    ("RK45", scipys, {"method": located}),
                )
                for restart in (False, True)
            }
            contenders["solve_ivp", True] = scipys(law, tolerances, terminal)
            found = measured(contenders, rounds)
            for way in ("compiled", "RK45", "solve_ivp"):
                kept = found["RK45" if way == "solve_ivp" else way, False]
                again = found[way, True]
                errors = [np.median(np.abs(one[0] - truth)[:, 0]) for one in (kept, again)]
                cells = f"{again[1] / kept[1]:.2f}", ratio(again[2], kept[2])
                ends = ", ".join(f"{1e3 * error:.1e} mm" for error in errors)
                row(scene, f"{tolerances[0]:g}", way, *cells, ends)


def costs(rounds):
    row("scene", "rtol", "law", "(a) RHS", "(a) time", "(b) time", "(c) RHS", "(c) time")
    row(*["---"] * 8)
    for scene, contact in SCENES.items():
        labels = ["piecewise", *LAWS[scene].split()]
        laws = [gs.contact_law(label, *contact) for label in labels]
        for tolerances in TOLERANCES:
            contenders = {}
            for label, law in zip(labels, laws, strict=True):
                method = terminal if label == "piecewise" else plain
                contenders["a", label] = compiled(law, tolerances, controller="ode45")
                contenders["b", label] = compiled(law, tolerances)
                contenders["c", label] = scipys(law, tolerances, method)
            found = measured(contenders, rounds)
            for label in labels[1:]:
                cells = []
                for way in "abc":
                    exact, one = found[way, "piecewise"], found[way, label]
                    if way != "b":  # a Taylor series has no right-hand sides
                        cells.append(f"{one[1] / exact[1]:.2f}")
                    cells.append(ratio(one[2], exact[2]))
                row(scene, f"{tolerances[0]:g}", f"`{label}`", *cells)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--cpu", type=int, help="stay on this processor")
    arguments = parser.parse_args()
    if arguments.cpu is not None:
        os.sched_setaffinity(0, {arguments.cpu})
    print("How many times smaller the error is by location:\n")
    modes()
    print("\nRestarted at every contact over located and kept:\n")
    restarts(arguments.rounds)
    print("\nOver the exact law: median and range\n")
    costs(arguments.rounds)


if __name__ == "__main__":
    main()
