"""Intervals of energies alone that know what windows share: the noise of the rays, and air."""

from __future__ import annotations

from roomfit.app.coherent.shared_errors import air_error, shared_steps
from roomfit.app.coherent.tracing_noise import with_tracing_noise
from roomfit.app.directing.energies import EnergyTask
from roomfit.app.fitting import Allow
from roomfit.app.problems import tells_of_band
from roomfit.identification.reweighted import BandFit
from roomfit.objective.directed_problem import DirectedProblem
from roomfit.objective.energy_problem import EnergyProblem
from roomfit.objective.problem import BandProblem, JointProblem
from roomfit.uncertainty.shared_errors import allowing_for


def allowing_for_shared_errors(task: EnergyTask) -> Allow:
    """Return what makes a band's fit as sure as the errors that its windows share permit.

    Room parameters without responses stay as they are.

    Parameters
    ----------
    task : EnergyTask
    """

    def allow(band: int, problem: BandProblem, fit: BandFit) -> BandFit:
        first = problem.parts[0] if isinstance(problem, JointProblem) else problem
        energies = first.problem if isinstance(first, DirectedProblem) else first
        if not isinstance(energies, EnergyProblem) or not fit.vector.size:
            return fit
        heard = [m for m in task.measured if tells_of_band(m, band)]
        sources = [int(task.scene.pairs[m.pair][0]) for m in heard]
        noisy = with_tracing_noise(problem, energies, sources, fit)
        air = air_error(task.scene.air, task.bands, band, energies)
        return allowing_for(noisy, shared_steps(problem, fit, energies, air))

    return allow
