"""What a surface near the rotors does to their thrust: ground effect and ceiling effect.

Both are ratios of the thrust near the surface to the thrust far from it *at the same power*, the
form in which both sources give them, and both are taken at the height of the airframe's centre: a tilt
changes nothing, and all rotors gain alike.

Ground: the rotor's image below the ground blows against its inflow (I. C. Cheeseman, W. E. Bennett, "The
effect of the ground on a helicopter rotor in forward flight", ARC R&M 3021, 1955), and so do, on a quadrotor,
the images of the other three rotors (P. Sanchez-Cuevas, G. Heredia, A. Ollero, "Characterization of the
aerodynamic ground effect and its influence in multirotor control", International Journal of Aerospace
Engineering 2017, 1823056). With rotor radius R, distance d of neighbouring rotors and height z of the rotors

    T / T_far = 1 / (1 - (R / 4z)^2 - R^2 z / (d^2 + 4z^2)^(3/2) - R^2 z / (2 (2d^2 + 4z^2)^(3/2)))

A source of strength R^2 v / 4 at a distance s below gives each term: s = 2z for the own image, two
neighbours at sqrt(d^2 + 4z^2), one opposite rotor. The second paper's further term for the flow that
rises below the body has a coefficient fitted to one airframe; it is left out.

Ceiling: what the rotor draws in must pass the gap below the ceiling (momentum theory as in Y. H. Hsiao,
P. Chirarattananon, "Ceiling effects for hybrid aerial-surface locomotion of small rotorcraft", IEEE/ASME
Transactions on Mechatronics 24(5), 2019). With the distance D from rotor to ceiling the radial inflow
v r / 2D has the mean square v^2 R^2 / 8D^2 over the disk; the wake then leaves with 2 g v, and

    g = 1/2 + 1/2 sqrt(1 + (R / D)^2 / 8),    T / T_far = g^(2/3)
"""

from __future__ import annotations

from dataclasses import dataclass

from sim_vehicle.frames import Array, Row, array_of, at_least, at_most, rows_of

NEAREST_GROUND = 0.5
"""Rotor radii from the ground below which the ratio grows no more (the source model fails there)."""

NEAREST_CEILING = 0.1
"""Rotor radii from the ceiling below which the ratio grows no more (blades bend; the gap is never zero)."""


@dataclass(frozen=True, slots=True)
class Proximity:
    """Surfaces near the vehicle and the rotors that feel them.

    Attributes
    ----------
    rotor_radius : m; 0.28 is the 22 inch propeller of `airframe.AirframeParameters`
    rotor_spacing : m, between neighbouring rotors (arm times the square root of 2)
    rotor_height : m, of the rotors above the ground while the vehicle stands
    ground_effect : the ground at z = 0 acts on the thrust
    ceiling_height : m above the ground; None for the open sky
    """

    rotor_radius: float = 0.28
    rotor_spacing: float = 0.622
    rotor_height: float = 0.25
    ground_effect: bool = True
    ceiling_height: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < 2.0 * self.rotor_radius <= self.rotor_spacing:
            raise ValueError(
                f"rotor radius of {self.rotor_radius:g} m: must be above zero, and rotors "
                f"{self.rotor_spacing:g} m apart must not overlap; give at most "
                f"{0.5 * self.rotor_spacing:g} m"
            )
        if not self.rotor_height >= 0.0:
            raise ValueError(f"rotor height of {self.rotor_height:g} m is below zero; give 0 or more")
        if self.ceiling_height is not None and not self.ceiling_height > self.rotor_height:
            raise ValueError(
                f"ceiling height of {self.ceiling_height:g} m is not above the rotors of the standing "
                f"vehicle ({self.rotor_height:g} m); raise it"
            )


def ground_ratio(proximity: Proximity, height: Row) -> Row:
    """Thrust over thrust far from the ground, 1 or more; `height` () or (N,) [m] of the rotors above it."""
    radius, spacing = proximity.rotor_radius, proximity.rotor_spacing
    z = at_least(height, NEAREST_GROUND * radius)
    own = (radius / (4.0 * z)) * (radius / (4.0 * z))
    neighbours = radius**2 * z / (spacing**2 + 4.0 * z * z) ** 1.5
    opposite = 0.5 * radius**2 * z / (2.0 * spacing**2 + 4.0 * z * z) ** 1.5
    return 1.0 / (1.0 - own - neighbours - opposite)


def ceiling_ratio(proximity: Proximity, distance: Row) -> Row:
    """Thrust over thrust far from the ceiling, 1 or more; `distance` () or (N,) [m] of the rotors to it."""
    gap = at_least(distance, NEAREST_CEILING * proximity.rotor_radius)
    near = proximity.rotor_radius / gap
    wake = 0.5 + 0.5 * (1.0 + 0.125 * near * near) ** 0.5
    return wake ** (2.0 / 3.0)


def thrust_ratio(proximity: Proximity, altitude: Row) -> Row:
    """Factor on the thrust of every rotor; `altitude` () or (N,) [m] is z of the airframe's centre."""
    height = altitude + proximity.rotor_height
    ratio: Row = ground_ratio(proximity, height) if proximity.ground_effect else 1.0
    if proximity.ceiling_height is None:
        return ratio
    return ratio * ceiling_ratio(proximity, proximity.ceiling_height - height)


def touch_ceiling(proximity: Proximity, rigid: Array) -> Array:
    """State (12[, N]) that has not passed the ceiling: the rotors stop there, nothing bounces."""
    if proximity.ceiling_height is None:
        return rigid
    rows = rows_of(rigid)
    highest = proximity.ceiling_height - proximity.rotor_height
    excess = at_least(rows[2] - highest, 0.0)
    passed = excess / at_least(excess, 1e-200)  # 1 or 0
    rows[5] = rows[5] - passed * at_least(rows[5], 0.0)
    rows[2] = at_most(rows[2], highest)
    return array_of(rows)
