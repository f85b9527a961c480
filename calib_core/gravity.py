"""Local gravity from latitude and height, the reference of every accelerometer calibration.

There are two formulas of normal gravity: WGS-84's Somigliana formula with the second-order free air
correction (NGA TR8350.2, 3rd ed., Eq. 4-1 and 4-3), which is the default, and that of Grammenos et al. 2018,
Eq. 16-18 (the International Gravity Formula with the free air correction).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from stillcal.calib_core.errors import UserError

Formula = Literal["somigliana", "igf"]

STANDARD = 9.80665
"""m/s^2, the conventional standard gravity (3rd CGPM, 1901): used where no location is known."""

EQUATOR, POLE = 9.7803253359, 9.8321849378
"""m/s^2, WGS-84 normal gravity at sea level (NGA TR8350.2, Table 3.4)."""

ANOMALY_UNCERTAINTY = 4e-4
"""m/s^2 (40 mGal): standard deviation over land of real gravity about the normal field.

The global rms of gravity anomalies is near 35 mGal (variance 1201 mGal^2: Heiskanen and Moritz, Physical
Geodesy, 1967, ch. 7)."""

UNKNOWN_HEIGHT = 500.0
"""m, standard uncertainty of the height where a location comes without one."""

FREE_AIR = 3.086e-6
"""1/s^2, the free air gradient (Grammenos et al. 2018, Eq. 18)."""


class LocationError(UserError):
    """Refusal of a latitude, longitude, altitude or gravity that no place on earth has."""


@dataclass(frozen=True, slots=True)
class Gravity:
    """Local gravity.

    value, uncertainty: m/s^2, one standard deviation. source: where it came from. formula, latitude (deg) and
    altitude (m): those it was computed with, None where it was not.
    """

    value: float = STANDARD
    uncertainty: float = (POLE - EQUATOR) / 12**0.5
    source: Literal["default", "location", "given"] = "default"
    formula: Formula | None = None
    latitude: float | None = None
    altitude: float | None = None

    @property
    def scale_uncertainty(self) -> float:
        """Relative uncertainty that g adds to a scale common to all axes; rests cannot show it."""
        return self.uncertainty / self.value


def igf(latitude: float, altitude: float = 0.0) -> float:
    """Return g in m/s^2 from latitude (deg) and height (m), by the IGF with the free air correction.

    Grammenos et al. 2018, Eq. 16-18.

    >>> round(igf(45.0), 5), round(igf(45.0, altitude=1000.0), 5)
    (9.8062, 9.80311)
    """
    phi = np.radians(latitude)
    at_sea_level = 9.780327 * (1 + 0.0053024 * np.sin(phi) ** 2 - 0.0000058 * np.sin(2 * phi) ** 2)
    return float(at_sea_level - FREE_AIR * altitude)


def somigliana(latitude: float, altitude: float = 0.0) -> float:
    """Return normal gravity in m/s^2 on the WGS-84 ellipsoid from geodetic latitude (deg) and height (m).

    Closed formula of Somigliana (NGA TR8350.2, Eq. 4-1) with the second-order free air correction
    (Eq. 4-3): g_h = g (1 - 2/a (1 + f + m - 2 f sin^2 phi) h + 3 h^2 / a^2).

    >>> somigliana(0.0) == EQUATOR, round(somigliana(90.0) - POLE, 9)
    (True, 0.0)
    """
    a, f, m = 6378137.0, 1 / 298.257223563, 0.00344978650684
    k, e2 = 0.00193185265241, 0.00669437999014
    s2 = np.sin(np.radians(latitude)) ** 2
    at_sea_level = EQUATOR * (1 + k * s2) / np.sqrt(1 - e2 * s2)
    free_air = 1 - 2 / a * (1 + f + m - 2 * f * s2) * altitude + 3 * (altitude / a) ** 2
    return float(at_sea_level * free_air)


def at(latitude: float, altitude: float | None, formula: Formula = "somigliana") -> Gravity:
    """Return local gravity at a location. latitude: deg, altitude: m or None where unknown.

    The uncertainty is that of the real field and, without an altitude, of the height.
    Raises LocationError outside +-90 deg or -500..12000 m.

    >>> munich = at(48.137, altitude=519.0)
    >>> round(munich.value, 4), munich.uncertainty
    (9.8074, 0.0004)
    """
    if not -90 <= latitude <= 90:
        raise LocationError(f"latitude {latitude} deg is not within -90..90")
    if altitude is not None and not -500 <= altitude <= 12000:
        raise LocationError(f"altitude {altitude} m is not within -500..12000")
    height_uncertainty = UNKNOWN_HEIGHT if altitude is None else 0.0
    value = {"somigliana": somigliana, "igf": igf}[formula](latitude, altitude or 0.0)
    uncertainty = float(np.hypot(ANOMALY_UNCERTAINTY, FREE_AIR * height_uncertainty))
    return Gravity(value, uncertainty, "location", formula, latitude, altitude)


def given(value: float, uncertainty: float = 0.0) -> Gravity:
    """Return gravity as it was measured, m/s^2. Raises LocationError on a value that no place has."""
    if not 9.7 <= value <= 9.9:
        raise LocationError(f"gravity {value} m/s^2 is not found on the earth's surface (9.76 to 9.84)")
    return Gravity(value, uncertainty, "given")
