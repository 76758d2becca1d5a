"""Conversion of models and contact laws to other units of mass, length and time."""

from dataclasses import replace

import gapsweep as gs


def rescaled_law(law, mass, length, time):
    force = mass * length / time**2
    if isinstance(law, gs.ForceTable):
        return gs.ForceTable([x * length for x in law.x], [f * force for f in law.F])
    gap = gs.Gap(law.gap.j_1 * length, law.gap.j_2 * length)
    new = {"K_c": law.K_c * force / length, "gap": gap}
    for name, unit in (("epsilon", 1.0 / length), ("gamma", 1.0 / length), ("fit_range", length)):
        if hasattr(law, name):
            new[name] = getattr(law, name) * unit
    return replace(law, **new)


def rescaled_model(model, mass, length, time):
    force = mass * length / time**2
    if isinstance(model, gs.Oscillator):
        return replace(
            model,
            omega_n=model.omega_n / time,
            mass=model.mass * mass,
            alpha=model.alpha * force / length**3,
            c=model.c * mass / time,
            forcing=model.forcing * force,
            mean_load=model.mean_load * force,
            unbalance=model.unbalance * mass * length,
            base_amplitude=model.base_amplitude * length,
        )
    lags = model.lags and gs.Lags(
        model.lags.force * mass / time**2,
        model.lags.of_speed,
        model.lags.of_place / time,
        model.lags.of_lags / time,
    )
    return replace(
        model,
        mass=model.mass * mass,
        damping=model.damping * mass / time,
        stiffness=model.stiffness * mass / time**2,
        cubic=[replace(each, alpha=each.alpha * force / length**3) for each in model.cubic],
        forcing=[
            replace(h, amplitude=h.amplitude * (force, force * time, mass * length)[h.power])
            for h in model.forcing
        ],
        lags=lags,
    )
