"""The chain as processes: simulated autopilot, bridge, manager, base station."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from uav_mission_manager.mdp import Energy
from uav_mission_manager.nodes.background import dying_with_parent
from uav_mission_manager.onboard.battery import cells

NAMESPACE = f'/uav{os.getpid()}'
"""Namespace of the vehicle; each run has one of its own, for two demos in one ROS domain."""

STOP_TIMEOUT = 5.0
"""Time [s] that a process has to end by itself before it is killed: a choice."""

BRIDGE_PARAMETERS = {
    'allow_arming': True,
    'goal_dwell': 1.0,
    'service_time': 1.0,
    'rtl_delay': 5.0,
}
"""The bridge's parameters; times are short because simulated time runs faster than its clock."""

MANAGER_PARAMETERS = {'command_dwell': 0.5}
"""The manager's parameters, short for the same reason."""

ALONE = {'listening_time': 0.0}
"""Parameters of nodes that are alone in their namespace."""

RECORDER = 'mission_record'
"""The process that nobody depends on."""


class Stack:
    """Starts the processes of one mission, watches them and ends them.

    Parameters
    ----------
    mission, policy : path
        Mission file and the policy set built from it.
    logs : path
        Directory for the log files, one for each process.
    speedup : float
        Simulated seconds per second.
    bag : path, optional
        Where to record it; None for nowhere.
    """

    def __init__(
        self, mission: Path, policy: Path, logs: Path, speedup: float, bag: Path | None = None
    ) -> None:
        self._bag = bag
        self.mission, self.policy, self.logs, self.speedup = mission, policy, logs, speedup
        logs.mkdir(parents=True, exist_ok=True)
        # New for each flight: what is there now would be gone on with by the nodes.
        self._ros_home = tempfile.mkdtemp(prefix='ros-home-', dir=logs)
        vehicle, crew = _free_udp_ports(2)
        self.crew_connection = f'udpin:127.0.0.1:{crew}'
        self._vehicle = f'127.0.0.1:{vehicle}'
        self._crew = f'127.0.0.1:{crew}'
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, origin: str, energy: Energy) -> None:
        """Start everything.

        `origin` is the home position, latitude,longitude,altitude; `energy` is the mission's:
        the vehicle has its battery, and flies at its speeds where they are given.
        """
        if self._bag is not None:
            self._start_node(RECORDER, bag=self._bag)
        self._start(
            'sim_autopilot',
            'autopilot.sim_autopilot',
            *('--connection', f'udpout:{self._vehicle}', '--connection', f'udpout:{self._crew}'),
            *(f'--origin={origin}', f'--speedup={self.speedup}'),
            f'--battery={cells(energy)},{energy.capacity},{energy.power}',
        )
        mission = {'mission': self.mission}
        connection = f'udpin:{self._vehicle}'
        speeds = {'cruise_speed': energy.speed, 'agile_speed': energy.agile_speed}
        self._start_node(
            'mavlink_bridge',
            connection=connection,
            **mission,
            **{name: value for name, value in speeds.items() if value is not None},
            **BRIDGE_PARAMETERS,
            **ALONE,
        )
        self._start_node('manager', policy=self.policy, **MANAGER_PARAMETERS, **ALONE)
        self._start_node('base_station', **mission, **ALONE)

    def ended(self) -> dict[str, int]:
        """Exit codes of the processes of the chain that are no longer there, by name."""
        codes = {name: process.poll() for name, process in self.processes.items()}
        return {n: code for n, code in codes.items() if code is not None and n != RECORDER}

    @property
    def recording_failed(self) -> bool:
        """Whether nothing is recorded any more that should be."""
        recorder = self.processes.get(RECORDER)
        return recorder is not None and recorder.poll() is not None

    def stop(self) -> None:
        """End everything, the vehicle last."""
        end_processes(reversed(self.processes.values()))

    def _start_node(self, name: str, **parameters: object) -> None:
        assignments = [
            word
            for key, value in parameters.items()
            for word in ('-p', f'{key}:={str(value).lower() if value is True else value}')
        ]
        self._start(name, f'nodes.{name}', '--ros-args', '-r', f'__ns:={NAMESPACE}', *assignments)

    def _start(self, name: str, module: str, *arguments: str) -> None:
        log = self.logs / f'{name}.log'
        self.processes[name] = start_process(log, self._ros_home, module, *arguments)


def start_process(
    log: Path, ros_home: str, module: str, *arguments: str
) -> subprocess.Popen[bytes]:
    """Start a module of this package, which writes into a file and dies with this process.

    It is in a session of its own, for Ctrl-C to reach the demo alone, which ends the rest.
    """
    with log.open('wb') as output:
        return subprocess.Popen(
            [sys.executable, '-m', f'uav_mission_manager.{module}', *arguments],
            stdout=output,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, 'PYTHONUNBUFFERED': '1', 'ROS_HOME': ros_home},
            preexec_fn=dying_with_parent(),
        )


def end_processes(processes: Iterable[subprocess.Popen[bytes]]) -> None:
    """End processes, all at once; one that does not is killed."""
    running = list(processes)
    for process in running:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
    for process in running:
        try:
            process.wait(STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _free_udp_ports(count: int) -> list[int]:
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for each in sockets:
        each.bind(('127.0.0.1', 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports
