"""gapsweep as a user calls it: `simulate` with an array of frequencies."""

from scenes import OSCILLATOR, Scene

import gapsweep as gs

TOLERANCES = tuple(10.0**-k for k in range(2, 13))


class Gapsweep:
    """A batch of neighbouring frequencies; `form` is ``piecewise`` or ``tanh:<epsilon>``.

    `sampled` also asks for the last period on the scene's grid, as heyoka's run does.
    """

    def __init__(self, form, width, sampled=False, **solver):
        label = ", sampled" if sampled else "".join(f", {k}={v}" for k, v in solver.items())
        self.name, self.width = f"gapsweep {width} points{label}", width
        self.label = form.replace(":", "-")
        self.sampled, self.solver = sampled, solver

    def run(self, scene: Scene, tolerance):
        """End state of the scene and its neighbours: (x, v), each of shape (width,)."""
        law = gs.contact_law(self.label, scene.K_c, scene.gap)
        run = gs.simulate(
            OSCILLATOR,
            law,
            scene.frequencies(self.width),
            t_end=scene.t_end,
            rtol=tolerance,
            atol=1e-3 * tolerance,
            dense_output=self.sampled,
            **self.solver,
        )
        if self.sampled:
            run.sample(scene.grid)
        return run.x_end, run.v_end
