"""What steers a fit: the choices of a user, and the constants that stand behind them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, get_args

from roomfit.base.arguments import check_known
from roomfit.base.errors import InputError

Method = Literal["auto", "simplex", "annealing", "least-squares"]
Model = Literal["auto", "energy", "coherent"]
Positions = Literal["auto", "fit", "fixed"]
# The paper's searches cannot follow many unknowns beside absorption.
LEAST_SQUARES_METHODS: tuple[Method, ...] = ("auto", "least-squares")
# Relative standard deviation of the speed of sound where nothing is specified.
SPEED_OF_SOUND_SD = 2e-3
DECAY_RANGE_DB = 50.0
# Of updated weights; four to twelve suffice nearly always, and a round costs a few evaluations.
MAX_ROUNDS = 100

# Lowest and highest value of every number, and why it ends there.
_RAYS = "1e8 take hours and gigabytes"
SETTING_LIMITS: Mapping[str, tuple[float, float, str]] = {
    "seed": (0, 2**63 - 1, "a whole number of 63 bits"),
    "n_rays": (1, 10**8, _RAYS),
    "n_rays_beside_images": (1, 10**8, _RAYS),
    "receiver_radius_m": (0.01, 5.0, "smaller catch no ray, larger average over the room"),
    "default_scattering": (0.0, 1.0, "a share of energy"),
    "n_draws": (2, 10**6, "one has no spread; more take gigabytes"),
    "n_random_starts": (0, 1000, "each costs as much as a fit"),
    "n_scattering_rays": (1, 10**8, _RAYS),
    "most_images": (1, 10**8, _RAYS),
    "most_coherent_images": (1, 10**8, _RAYS),
    "most_triangles_for_images": (0, 10**7, "no room file has more"),
    "coherent_until_s": (0.01, 10.0, "s; earlier than any reflection, later than any decay"),
    "speed_of_sound_sd": (1e-6, 0.2, "relative; air in a room is between -20 and 50 degrees"),
    "decay_range_db": (10.0, 200.0, "dB; less holds no decay, more no recording"),
    "max_rounds": (1, 10_000, "a fit that needs more does not converge"),
    "temperature_sd_c": (0.0, 30.0, "degrees; rooms are between -20 and 50"),
}


@dataclass(frozen=True, slots=True)
class Settings:
    """How to identify, predict and design; the defaults are what the command line takes.

    Those that differ from the default are written into result.json.

    Raises
    ------
    InputError
        A value is unknown or out of its range.

    Examples
    --------
    >>> Settings(seed=3).changed()
    {'seed': 3}
    """

    method: Method = "auto"  # "auto": least squares with profile intervals
    model: Model = "auto"  # "auto": partly coherent where image sources reach far enough
    seed: int = 1  # of every random number, 0 to 2**63 - 1
    positions: Positions = "auto"  # whether positions move within their standard deviation
    reflection_delays: bool = True  # whether walls may delay what they reflect
    temperature_sd_c: float | None = None  # standard deviation of the air's temperature, K
    # Left out, these follow volume and decay of the room (`roomfit.fit.trace_plan`).
    n_rays: int | None = None  # rays a source, 60,000 at least
    n_rays_beside_images: int | None = None  # a third of them, in a room of smooth walls
    receiver_radius_m: float | None = None  # of the spheres that catch rays, 0.5 m at least
    default_scattering: float = 0.1  # scattering coefficient of walls where it is unspecified
    n_draws: int = 128  # draws of the absorption behind a prediction's intervals
    n_random_starts: int = 3  # of energies alone: do they end in one minimum?
    n_scattering_rays: int = 20_000  # rays a source of the trials that choose the scattering
    # Image sources of every order are enumerated as long as they stay below these numbers a pair:
    # where they are all there is, as in a box of smooth walls, and for pressures.
    most_images: int = 400_000
    most_coherent_images: int = 60_000
    most_triangles_for_images: int = 600  # a furnished room's images end within milliseconds
    # Pressures are added in windows that end by this time after emission; later ones add little
    # information and need many more images.
    coherent_until_s: float = 0.2
    speed_of_sound_sd: float = SPEED_OF_SOUND_SD  # relative, where temperature_sd_c is unspecified
    # Windows are fitted until the decay curve of a response has fallen by so much, or to its noise.
    decay_range_db: float = DECAY_RANGE_DB
    max_rounds: int = MAX_ROUNDS  # steps of a fit at most, each with weights of its own
    # A first answer: Gaussian intervals, and no search for what files, positions or chain may have
    # wrong.
    quick: bool = False

    def __post_init__(self) -> None:
        for key, value, known in (
            ("method", self.method, get_args(Method)),
            ("model", self.model, get_args(Model)),
            ("positions", self.positions, get_args(Positions)),
        ):
            check_known("unknown setting", value, known, where=f"settings.{key}")
        for key, (low, high, why) in SETTING_LIMITS.items():
            value = getattr(self, key)
            if value is not None and not low <= value <= high:
                raise InputError(
                    "setting out of range",
                    where=f"settings.{key}",
                    found=f"{value:g}",
                    needed=f"{low:g} to {high:g}",
                    hint=why,
                )

    def changed(self) -> dict[str, Any]:
        """Return the settings that differ from the default, by name."""
        return {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if getattr(self, f.name) != f.default
        }
