"""The ego's motion as its own sensors measure it, an INS or wheels and a yaw rate sensor, and as their frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.binding.bind_protection import counter_period
from candaemon.binding.bound import BoundEgo, EgoMessage
from candaemon.binding.compile_condition import candidates, first_that
from candaemon.config.ego import InsSettings, OdometrySettings
from candaemon.config.protection import InputProtectionSettings
from candaemon.errors import ConfigError
from candaemon.frames.frame import Frame
from candaemon.objects.signals import SignalBinding
from candaemon.simulation.actor_motion import TrueMotion
from candaemon.simulation.faults import FrameLosses, Spells, Steps
from candaemon.simulation.message_writer import MessageWriter
from candaemon.simulation.random_streams import stream
from candaemon.simulation.scenario import EgoMotionSensors, EgoStart, Scenario
from candaemon.simulation.scene import Scene
from candaemon.simulation.schedule import batched, start_ns

LEAD_IN = 0.3
"""The ego motion is sent from this many s before the scenario's time 0, so that it is known at the first scan."""
_BLOCK = 256


class EgoEncoder:
    """Writes the ego's motion at its rate; all messages of an instant carry the same time stamp.

    Args:
        ego: the configuration's ego, bound to its DBC.
        scenario: gives rate, errors, loss and jitter.
        seed: of the simulation.
        source: index of its random streams.

    Raises:
        ConfigError: a signal that cannot be written.

    """

    def __init__(self, ego: BoundEgo, scenario: Scenario, *, seed: int, source: int) -> None:
        self._settings, self._bus, self._scenario = ego.settings, ego.bus, scenario
        self._gears = _gears(ego)
        self._random = stream(seed, source, "own_motion")
        self._loss = stream(seed, source, "loss")
        protections = [ego.settings.protection.get(each.message.name) for each in ego.messages.values()]
        counters = [_counter(each, settings) for each, settings in zip(ego.messages.values(), protections, strict=True)]
        self._periods = [period for _, period in counters]
        self._writers = [
            MessageWriter(each.message, (*each.bindings, *counter))
            for each, (counter, _) in zip(ego.messages.values(), counters, strict=True)
        ]
        self._protectors = [None if each.monitor is None else each.monitor.protector for each in ego.messages.values()]
        self._names = [each.quantities for each in ego.messages.values()]
        sensors = scenario.ego.own_motion
        draws = stream(seed, source, "faults")
        self._losses = FrameLosses(scenario.frames.faults, draws)
        self._faults, self._gaps, self._steps = sensors.faults, None, None
        if sensors.faults is not None:
            self._gaps = Spells(sensors.faults.gap_interval, sensors.faults.gap, draws)
            self._steps = Steps(sensors.faults.step_interval, sensors.faults.step, draws)
        self._drift: Drift | None = None
        if isinstance(ego.settings, InsSettings):
            noise = ego.settings.noise
            turns = [math.radians(noise.heading_deg), math.radians(noise.yaw_rate_deg)]
            deviation = sensors.noise * np.array([noise.velocity, noise.velocity, *turns])
            self._drift = Drift(deviation, 1.0 / sensors.rate, sensors.drift_time, self._random)

    def frames(self, scene: Scene) -> Iterator[Frame]:
        """Yield the frames in order of time, lost ones left out."""
        sensors, transmission = self._scenario.ego.own_motion, self._scenario.frames
        first = -math.floor(LEAD_IN * sensors.rate)
        count = math.ceil(self._scenario.duration * sensors.rate) + 1 - first
        start, last = start_ns(self._scenario), -(1 << 62)
        for begin in range(0, count, _BLOCK):
            steps = first + np.arange(begin, min(begin + _BLOCK, count))
            micro = np.rint(steps / sensors.rate * 1e6).astype(np.int64)
            motion = scene.ego(micro / 1e6)
            exact = self._exact(motion, micro / 1e6)
            coded = [(writer.message, self._payloads(k, steps, exact)) for k, writer in enumerate(self._writers)]
            delay = self._settings.latency + transmission.jitter * self._loss.exponential(1.0, len(steps))
            stamped = batched(start + (micro + np.rint(delay * 1e6).astype(np.int64)) * 1000, transmission)
            kept = self._loss.random((len(steps), len(coded))) >= transmission.loss
            kept &= ~self._silent(micro / 1e6, np.abs(motion.velocity)) & ~self._faulty(
                start + micro * 1000, len(coded)
            )
            for k, time in enumerate(stamped.tolist()):
                last = max(time, last)
                for (message, payloads), keep in zip(coded, kept[k], strict=True):
                    if keep:
                        yield Frame(last, self._bus, message.can_id, payloads[k], message.is_fd)

    def _silent(self, times: Floats, speeds: Floats) -> Booleans:
        """Return which messages are not sent at n instants, (n, messages): those with a quantity that is silent."""
        sensors = self._scenario.ego.own_motion
        silent = np.zeros((len(times), len(self._names)), dtype=np.bool_)
        for index, names in enumerate(self._names):
            for quantity, speed in sensors.silent_below.items():
                if quantity in names:
                    silent[:, index] |= speeds < speed
            for silence in sensors.silent:
                if silence.quantity in names:
                    silent[:, index] |= (times >= silence.begin) & (times < silence.end)
        return silent

    def _faulty(self, times_ns: Integers, messages: int) -> Booleans:
        """Return which messages of n instants a fault keeps away, (n, messages)."""
        lost = self._losses.lost(np.repeat(times_ns, messages)).reshape(len(times_ns), messages)
        return lost if self._gaps is None else lost | self._gaps.cover(times_ns)[:, None]

    def _payloads(self, index: int, steps: Integers, exact: dict[str, Floats]) -> list[bytes]:
        """Write one message at several instants, counted and with its checksum where it has them."""
        writer, period, protector = self._writers[index], self._periods[index], self._protectors[index]
        rows = [self._reading(name, exact[name]) for name in self._names[index]]
        rows += [(steps % period).astype(np.float64)] if period else []
        payloads = writer.payloads(np.stack(rows))
        if protector is None:
            return payloads
        return [protector.seal(writer.message.can_id, payload) for payload in payloads]

    def _exact(self, motion: TrueMotion, times: Floats) -> dict[str, Floats]:
        """Return the quantities that the ego's sensors measure, by name, in SI units, with an INS's drift and faults.

        Args:
            motion: at n instants.
            times: the instants, s since the scenario's start.

        """
        settings, sensors = self._settings, self._scenario.ego.own_motion
        if isinstance(settings, OdometrySettings):
            backwards = np.real(motion.velocity * np.exp(-1j * motion.yaw)) < -_CREEP
            return odometry_values(motion, settings, sensors) | {"reverse": np.where(backwards, *self._gears)}
        count = len(motion.yaw)
        errors = np.zeros((4, count)) if self._drift is None else self._drift.next(count)
        if self._faults is not None and self._steps is not None:
            errors[2] += math.radians(self._faults.heading_bias_deg)
            east, north = self._steps.at(times)
            motion = replace(motion, position=motion.position + east + 1j * north)
        return ins_values(motion, errors, settings, self._scenario.ego.start)

    def _reading(self, quantity: str, exact: Floats) -> Floats:
        """Return one signal's reading of a quantity: odometry with its white noise, speeds without their sign."""
        settings = self._settings
        if isinstance(settings, InsSettings) or quantity == "reverse":
            return exact
        factor, draws = self._scenario.ego.own_motion.noise, self._random.standard_normal(len(exact))
        if quantity == "yaw_rate":
            return exact + factor * math.radians(settings.noise.yaw_rate_deg) * draws
        return np.maximum(exact + factor * settings.noise.speed * draws, 0.0)


def _gears(ego: BoundEgo) -> tuple[float, float]:
    """Return a value of the signal that says so while the vehicle drives backwards, and one that it has otherwise.

    Raises:
        ConfigError: the signal has no such value.
    """
    condition = ego.settings.signals.reverse if isinstance(ego.settings, OdometrySettings) else None
    if condition is None or ego.reverse is None:
        return 1.0, 0.0
    (signal,) = (
        each.signal for message in ego.messages.values() for each in message.bindings if each.quantity == "reverse"
    )
    values, passes = candidates(signal, [condition]), ego.reverse.passes
    backwards, forwards = first_that(values, passes), first_that(values, lambda value: not passes(value))
    if backwards is None or forwards is None:
        raise ConfigError(f"ego.signals.reverse: '{signal.name}' has no value that passes and one that does not")
    return backwards, forwards


def _counter(message: EgoMessage, protection: InputProtectionSettings | None) -> tuple[tuple[SignalBinding, ...], int]:
    """Return the counter that protects a message and its number of values; none and 0 where there is no counter."""
    if protection is None or protection.counter is None:
        return (), 0
    signal = message.message.signal(protection.counter)
    return (SignalBinding("counter", signal, 1.0, 0.0),), counter_period(protection, signal)


_SEMI_MAJOR = 6_378_137.0
_ECCENTRICITY_SQUARED = 6.694_379_990_14e-3
_CREEP = 1e-6
"""Speed backwards above which the gear says so, m/s."""
_CRAWL = 0.5
"""Speed below which the curvature is reported as 0, m/s."""


def geodetic(east: Floats, north: Floats, start: EgoStart) -> tuple[Floats, Floats]:
    """Return latitude and longitude (deg, WGS 84) of positions in the local frame (m).

    North is measured along the origin's meridian, east along the point's own parallel; the radii of curvature are
    those of the origin. The deviation from the geodesic is millimetres per kilometre.
    """
    latitude = math.radians(start.latitude)
    squared = 1 - _ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
    meridian = _SEMI_MAJOR * (1 - _ECCENTRICITY_SQUARED) / squared**1.5
    normal = _SEMI_MAJOR / math.sqrt(squared)
    latitudes = latitude + north / meridian
    return np.degrees(latitudes), start.longitude + np.degrees(east / (normal * math.cos(latitude)))


class Drift:
    """Slowly varying errors: first-order Gauss-Markov processes, continued from call to call.

    Args:
        deviation: standard deviation of each, shape (n,).
        step: s between two values.
        time: s, correlation time.
        random: generator to draw from.

    """

    def __init__(self, deviation: Floats, step: float, time: float, random: np.random.Generator) -> None:
        self._deviation, self._random = deviation, random
        self._keep = math.exp(-step / time)
        self._last = deviation * random.standard_normal(len(deviation))

    def next(self, count: int) -> Floats:
        """Return the next errors, shape (n, count)."""
        spread = self._deviation * math.sqrt(1 - self._keep**2)
        draws = self._random.standard_normal((count, len(spread))) * spread
        errors = np.empty((len(spread), count))
        last = self._last
        for k in range(count):
            last = self._keep * last + draws[k]
            errors[:, k] = last
        self._last = last
        return errors


def ins_values(motion: TrueMotion, errors: Floats, settings: InsSettings, start: EgoStart) -> dict[str, Floats]:
    """Return the readings of an INS at n instants, by the names of `InsSignals`, in SI units, angles in radians.

    Args:
        motion: of the ego, local axes.
        errors: of velocity north and east (m/s), heading and yaw rate (rad, rad/s), shape (4, n).
        settings: give the lever arm of the INS.
        start: the origin on earth.

    """
    arm = complex(settings.lever_arm.x, settings.lever_arm.y) * np.exp(1j * motion.yaw)
    position = motion.position + arm
    velocity = motion.velocity + 1j * motion.yaw_rate * arm + errors[1] + 1j * errors[0]
    latitude, longitude = geodetic(position.real, position.imag, start)
    speed = np.abs(velocity)
    yaw_rate = motion.yaw_rate + errors[3]
    acceleration = motion.acceleration * np.exp(-1j * motion.yaw)
    return {
        "latitude": np.radians(latitude),
        "longitude": np.radians(longitude),
        "velocity_north": velocity.imag,
        "velocity_east": velocity.real,
        "speed": speed,
        "heading": np.mod(math.pi / 2 - motion.yaw + errors[2], 2 * math.pi),
        "yaw_rate": yaw_rate,
        "valid": np.ones_like(speed),
        "curvature": np.where(speed > _CRAWL, yaw_rate / np.maximum(speed, _CRAWL), 0.0),
        "slip": np.where(speed > _CRAWL, np.angle(velocity * np.exp(-1j * motion.yaw)), 0.0),
        "ax": acceleration.real,
        "ay": acceleration.imag,
    }


def odometry_values(motion: TrueMotion, settings: OdometrySettings, sensors: EgoMotionSensors) -> dict[str, Floats]:
    """Return the readings of wheels, speedometer and yaw rate sensor at n instants, by the names of `OdometrySignals`.

    In SI units, with biases and scale factors but without noise. The wheels are those of the rear axle; like the
    speedometer they do not tell which way they turn.
    """
    speed = np.real(motion.velocity * np.exp(-1j * motion.yaw))
    sign = np.where(speed < 0.0, -1.0, 1.0)
    speed, inward = sign * speed, sign * settings.track_width / 2 * motion.yaw_rate
    return {
        "left_wheels": sensors.speed_factor * (speed - inward),
        "right_wheels": sensors.speed_factor * (speed + inward),
        "speed": sensors.speed_factor * speed + sensors.speed_offset,
        "yaw_rate": motion.yaw_rate + math.radians(sensors.yaw_rate_bias_deg),
    }
