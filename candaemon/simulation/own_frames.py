"""The ego's motion as the frames of its INS, or of its wheels and yaw rate sensor."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from candaemon.arrays import Floats, Integers
from candaemon.binding.bind_protection import counter_period
from candaemon.binding.bound import BoundEgo, EgoMessage
from candaemon.config.ego import InsSettings, OdometrySettings
from candaemon.config.protection import InputProtectionSettings
from candaemon.frames.frame import Frame
from candaemon.objects.signals import SignalBinding
from candaemon.simulation.actor_motion import TrueMotion
from candaemon.simulation.message_writer import MessageWriter
from candaemon.simulation.own_motion import Drift, ins_values, odometry_values
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.scene import Scene
from candaemon.simulation.schedule import start_ns
from candaemon.simulation.streams import stream

LEAD_IN = 0.3
"""s before the scenario's time 0 from which own motion is told, so that the first scan finds it known."""
_BLOCK = 256


class OwnEncoder:
    """Writes the ego's motion at its rate; all messages of an instant carry the same stamp.

    Args:
        ego: the configuration's own motion, bound.
        scenario: gives rate, errors, loss and jitter.
        seed: of the simulation.
        source: index of its random streams.

    Raises:
        ConfigError: a signal that cannot be written.

    """

    def __init__(self, ego: BoundEgo, scenario: Scenario, *, seed: int, source: int) -> None:
        self._settings, self._bus, self._scenario = ego.settings, ego.bus, scenario
        self._random = stream(seed, source, "own_motion")
        self._loss = stream(seed, source, "loss")
        protections = [ego.settings.protection.get(each.message.name) for each in ego.messages.values()]
        counters = [_counter(each, settings) for each, settings in zip(ego.messages.values(), protections, strict=True)]
        self._periods = [period for _, period in counters]
        self._writers = [
            MessageWriter(each.message, (*each.bindings, *counter))
            for each, (counter, _) in zip(ego.messages.values(), counters, strict=True)
        ]
        self._protectors = [None if each.guard is None else each.guard.protector for each in ego.messages.values()]
        self._names = [each.quantities for each in ego.messages.values()]
        own = scenario.ego.own_motion
        self._drift: Drift | None = None
        if isinstance(ego.settings, InsSettings):
            noise = ego.settings.noise
            turns = [math.radians(noise.heading_deg), math.radians(noise.yaw_rate_deg)]
            deviation = own.noise * np.array([noise.velocity, noise.velocity, *turns])
            self._drift = Drift(deviation, 1.0 / own.rate, own.drift_time, self._random)

    def frames(self, scene: Scene) -> Iterator[Frame]:
        """Yield the frames in order of time, lost ones left out."""
        own, transmission = self._scenario.ego.own_motion, self._scenario.frames
        first = -math.floor(LEAD_IN * own.rate)
        count = math.ceil(self._scenario.duration * own.rate) + 1 - first
        start, last = start_ns(self._scenario), -(1 << 62)
        for begin in range(0, count, _BLOCK):
            steps = first + np.arange(begin, min(begin + _BLOCK, count))
            micro = np.rint(steps / own.rate * 1e6).astype(np.int64)
            exact = self._exact(scene.ego(micro / 1e6))
            coded = [(writer.message, self._payloads(k, steps, exact)) for k, writer in enumerate(self._writers)]
            delay = self._settings.latency + transmission.jitter * self._loss.exponential(1.0, len(steps))
            stamped = start + (micro + np.rint(delay * 1e6).astype(np.int64)) * 1000
            kept = self._loss.random((len(steps), len(coded))) >= transmission.loss
            for k, time in enumerate(stamped.tolist()):
                last = max(time, last)
                for (message, payloads), keep in zip(coded, kept[k], strict=True):
                    if keep:
                        yield Frame(last, self._bus, message.can_id, payloads[k], message.is_fd)

    def _payloads(self, index: int, steps: Integers, exact: dict[str, Floats]) -> list[bytes]:
        """Write one message at several instants, counted and with its checksum where it has them."""
        writer, period, protector = self._writers[index], self._periods[index], self._protectors[index]
        rows = [self._reading(name, exact[name]) for name in self._names[index]]
        rows += [(steps % period).astype(np.float64)] if period else []
        payloads = writer.payloads(np.stack(rows))
        if protector is None:
            return payloads
        return [protector.seal(writer.message.can_id, payload) for payload in payloads]

    def _exact(self, motion: TrueMotion) -> dict[str, Floats]:
        """Return the quantities that the ego's sensors tell, by name, SI; an INS's drift is in them."""
        settings, own = self._settings, self._scenario.ego.own_motion
        if isinstance(settings, OdometrySettings):
            return odometry_values(motion, settings, own)
        count = len(motion.yaw)
        errors = np.zeros((4, count)) if self._drift is None else self._drift.next(count)
        return ins_values(motion, errors, settings, self._scenario.ego.start)

    def _reading(self, quantity: str, exact: Floats) -> Floats:
        """Return one signal's reading of a quantity: odometry with noise of its own, speeds never below 0."""
        settings = self._settings
        if isinstance(settings, InsSettings):
            return exact
        factor, draws = self._scenario.ego.own_motion.noise, self._random.standard_normal(len(exact))
        if quantity == "yaw_rate":
            return exact + factor * math.radians(settings.noise.yaw_rate_deg) * draws
        return np.maximum(exact + factor * settings.noise.speed * draws, 0.0)


def _counter(own: EgoMessage, protection: InputProtectionSettings | None) -> tuple[tuple[SignalBinding, ...], int]:
    """Find the counter that protects a message, where one does, and how many values it has."""
    if protection is None or protection.counter is None:
        return (), 0
    signal = own.message.signal(protection.counter)
    return (SignalBinding("counter", signal, 1.0, 0.0),), counter_period(protection, signal)
