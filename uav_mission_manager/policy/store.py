"""Policy sets on disk: a directory with `manifest.json` and one `.npy` file an array.

The manifest holds the schema version, the whole mission and its hash, the method, the plan of
Algorithm 1 with its map phi, and for each sub-MDP what it is, how well it is solved and the
SHA-256 of its arrays; `digest` is the SHA-256 of all the rest of the manifest. There is no date,
so the same mission gives the same bytes. A set takes its place in one step, and what was verified
of it is what is used, whatever happens to its files afterwards.
"""

from __future__ import annotations

import hashlib
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uav_mission_manager.echo import quoted, shown, why_not
from uav_mission_manager.mdp import Mission, MissionError, mission_from_dict
from uav_mission_manager.mdp.arrays import AnyArray
from uav_mission_manager.mdp.fields import numbers
from uav_mission_manager.paths import opened_file
from uav_mission_manager.policy.certificate import Certificate
from uav_mission_manager.policy.private_copy import CHUNK_BYTES, private_copy
from uav_mission_manager.policy.replacement import taking_the_place_of
from uav_mission_manager.solver.bounds import LowerBound
from uav_mission_manager.solver.decomposition.plan import Plan
from uav_mission_manager.solver.exact import Solution
from uav_mission_manager.solver.expansion import Clusters, Expansion, Group
from uav_mission_manager.solver.submdp import SubMdp

MANIFEST_SCHEMA = 4
"""Version of what a manifest holds; 4: goals are completed by the action, W over cells."""

MANIFEST_FILE = 'manifest.json'
"""Name of the file that says what the others of a policy set are."""

SOLUTION_ARRAYS = {'value': ('float64', 'float32'), 'actions': ('uint8',)}
"""Arrays of a solution that are stored, and the types that each may have."""

MAX_HEADER_BYTES = 10 + 0xFFFF
"""Bytes before the numbers of an `.npy` file of version 1.0, at most."""

FLOAT_TYPES = ('float32', 'float64')
EXPANSION_FIELDS = ('points', 'iterations', 'spread', 'converged', 'fresh_residual')
"""Attributes of an expansion that its manifest holds."""

SOLUTION_FIELDS = ('lower', 'upper', 'residual', 'iterations', 'converged')
"""Attributes of a solution that its manifest holds."""


class PolicyError(ValueError):
    """A policy set that cannot be used or written; the message names the file and the field."""


@dataclass(frozen=True)
class PolicySet:
    """What a policy set holds: a mission, its plan, and solved sub-MDPs or an expansion."""

    mission: Mission
    method: str
    plan: Plan
    solutions: tuple[Solution, ...]
    expansion: Expansion | None = None
    certificate: Certificate | None = None


def write_policy_set(contents: PolicySet, directory: Path) -> str:
    """Write a policy set, replacing one that is there; return its digest.

    Raises
    ------
    PolicyError
        If the place holds something that is no policy set, or cannot be written.
    ValueError
        If the mission has what no mission file can say.
    """
    try:
        if directory.exists() and not _replaceable(directory):
            raise PolicyError(f'{shown(directory)}: exists and is no policy set; not overwritten')
        with taking_the_place_of(directory) as fresh:
            return _write(contents, fresh)
    except OSError as error:
        raise PolicyError(f'{shown(directory)}: cannot be written: {why_not(error)}') from error


def read_policy_set(directory: Path) -> tuple[PolicySet, str]:
    """Read and check a policy set, and its digest; its files are not used any more afterwards.

    Raises
    ------
    PolicyError
        At a wrong schema, hash, shape or mission.
    """
    while True:
        before = _identity(directory)
        try:
            return _read(directory)
        except PolicyError:
            # Replaced meanwhile: files of two sets do not fit together, and the new one is whole.
            if _identity(directory) == before:
                raise


def read_mission(directory: Path) -> Mission:
    """Return the mission of a policy set, whose arrays are left unread.

    Raises
    ------
    PolicyError
        As `read_policy_set` does.
    """
    place = directory / MANIFEST_FILE
    try:
        return mission_from_dict(_read_manifest(place)['mission'], str(place))
    except (LookupError, MissionError) as error:
        raise PolicyError(f'{shown(place)}: mission: {shown(error)}') from error


def read_digest(directory: Path) -> str:
    """Return the digest of a policy set, whose arrays are left unread. Raises `PolicyError`."""
    return str(_read_manifest(directory / MANIFEST_FILE)['digest'])


def _identity(directory: Path) -> tuple[int, ...]:
    """What differs between a directory and one that has taken its place; empty without any."""
    try:
        found = directory.stat()
    except OSError:
        return ()
    return found.st_dev, found.st_ino, found.st_ctime_ns


def _read(directory: Path) -> tuple[PolicySet, str]:
    place = directory / MANIFEST_FILE
    manifest = _read_manifest(place)
    try:
        mission = mission_from_dict(manifest['mission'], str(place))
        if mission.digest() != manifest['mission_sha256']:
            raise PolicyError(f'{shown(place)}: mission_sha256: does not match the mission')
        solutions = tuple(_read_part(directory, mission, part) for part in manifest['sub_mdps'])
        expansion = None
        if 'expansion' in manifest:
            expansion = _read_expansion(directory, mission, manifest['expansion'])
        certificate = None
        if 'certificate' in manifest:
            certificate = _read_certificate(directory, mission, manifest['certificate'])
        plan = Plan.from_dict(mission, manifest['plan'])
        contents = PolicySet(
            mission, str(manifest['method']), plan, solutions, expansion, certificate
        )
    except MissionError as error:
        raise PolicyError(str(error)) from error
    except (LookupError, TypeError, ValueError) as error:
        if isinstance(error, PolicyError):
            raise
        raise PolicyError(
            f'{shown(place)}: a field is missing or of the wrong type: {shown(error)}'
        ) from error
    return contents, str(manifest['digest'])


def _replaceable(directory: Path) -> bool:
    """Whether a directory is empty, or has a manifest and no files but a policy set's."""
    names = {path.name for path in directory.iterdir()} if directory.is_dir() else {''}
    return not names or (
        MANIFEST_FILE in names
        and all(name == MANIFEST_FILE or name.endswith('.npy') for name in names)
    )


def _digest(manifest: dict[str, Any]) -> str:
    rest = {key: value for key, value in manifest.items() if key != 'digest'}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def _write(contents: PolicySet, directory: Path) -> str:
    manifest: dict[str, Any] = {
        'schema': MANIFEST_SCHEMA,
        'method': contents.method,
        'mission': contents.mission.to_dict(),
        'mission_sha256': contents.mission.digest(),
        'plan': contents.plan.to_dict(),
        'sub_mdps': [
            _write_part(directory, position, solution)
            for position, solution in enumerate(contents.solutions)
        ],
    }
    if contents.expansion is not None:
        manifest['expansion'] = _write_expansion(directory, contents.expansion)
    if contents.certificate is not None:
        bound = contents.certificate.bound
        manifest['certificate'] = {
            **contents.certificate.summary(),
            'clusters': bound.clusters.tolist(),
            'tables': _write_array(directory / 'bound.npy', bound.tables),
        }
    manifest['digest'] = _digest(manifest)
    (directory / MANIFEST_FILE).write_text(_text(manifest))
    return str(manifest['digest'])


def _text(manifest: dict[str, Any]) -> str:
    return json.dumps(manifest, indent=1, sort_keys=True) + '\n'


def _write_part(directory: Path, position: int, solution: Solution) -> dict[str, Any]:
    arrays = {}
    for name in SOLUTION_ARRAYS:
        array = getattr(solution, name)
        if array is not None:
            arrays[name] = _write_array(directory / f'{position}_{name}.npy', array)
    sub = solution.sub
    return {
        'goals': [sub.mission.goals[j].name for j in sub.goals],
        'actions': list(sub.numbers),
        'share': sub.share,
        'travel': sub.travel,
        'goal_shares': list(sub.goal_shares),
        **{name: getattr(solution, name) for name in SOLUTION_FIELDS},
        'arrays': arrays,
    }


def _write_expansion(directory: Path, expansion: Expansion) -> dict[str, Any]:
    return {
        'clusters': [
            {'detail': group.detail, 'clusters': group.clusters}
            for group in expansion.clusters.groups
        ],
        **{name: getattr(expansion, name) for name in EXPANSION_FIELDS},
        'theta': _write_array(directory / 'theta.npy', expansion.theta),
    }


def _write_array(file: Path, array: AnyArray) -> dict[str, str]:
    np.save(file, array, allow_pickle=False)
    return {'file': file.name, 'sha256': _sha256(file)}


def _read_expansion(directory: Path, mission: Mission, part: dict[str, Any]) -> Expansion:
    values, conditions = 3 * mission.range.flag_values, 8 * mission.range.levels
    groups = [
        Group(group['detail'], _goals(mission, group['clusters']), values)
        for group in part['clusters']
    ]
    clusters = Clusters(tuple(groups))
    shape = mission.grid.q, len(mission.threat.levels), conditions, clusters.features
    theta = _read_array(directory, part['theta'], shape, FLOAT_TYPES)
    return Expansion(mission, clusters, theta, **numbers(part, EXPANSION_FIELDS))


def _goals(mission: Mission, clusters: list[list[int]]) -> tuple[tuple[int, ...], ...]:
    """Return clusters of goals, counted from 0."""
    if not all(type(j) is int and 0 <= j < mission.k for cluster in clusters for j in cluster):
        raise ValueError(f'clusters: {quoted(clusters)} are not all of goals')
    return tuple(map(tuple, clusters))


def _read_certificate(directory: Path, mission: Mission, part: dict[str, Any]) -> Certificate:
    clusters = np.array(_goals(mission, part['clusters']))
    whole = mission.grid.q, len(mission.threat.levels), 8 * mission.range.levels
    shape = len(clusters), *whole, *(3 * mission.range.flag_values,) * clusters.shape[1]
    tables = _read_array(directory, part['tables'], shape, FLOAT_TYPES)
    bound = LowerBound(mission, clusters, tables)
    rest = {name: part[name] for name in part if name not in ('clusters', 'tables')}
    numbers(rest, [name for name in rest if rest[name] is not None or 'gap' not in name])
    return Certificate(bound, **rest)


def _sha256(file: Path) -> str:
    digest = hashlib.sha256()
    with file.open('rb') as stream:
        while chunk := stream.read(CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def _read_manifest(place: Path) -> dict[str, Any]:
    try:
        with open(opened_file(place), encoding='utf-8') as stream:
            text = stream.read()
        manifest = json.loads(text)
    except OSError as error:
        raise PolicyError(f'{shown(place)}: cannot be read: {why_not(error)}') from error
    except (ValueError, RecursionError) as error:
        raise PolicyError(f'{shown(place)}: not valid JSON: {shown(error)}') from error
    if not isinstance(manifest, dict) or manifest.get('schema') != MANIFEST_SCHEMA:
        raise PolicyError(f'{shown(place)}: schema: is not {MANIFEST_SCHEMA}')
    # The text too: 1E-08 and 1e-08 are the same number.
    if manifest.get('digest') != _digest(manifest) or text != _text(manifest):
        raise PolicyError(f'{shown(place)}: digest: does not match the manifest; it was altered')
    return manifest


def _read_part(directory: Path, mission: Mission, part: dict[str, Any]) -> Solution:
    positions = {goal.name: position for position, goal in enumerate(mission.goals)}
    goals = tuple(positions[name] for name in part['goals'])
    sub = SubMdp(
        mission,
        goals,
        tuple(part['actions']),
        part['share'],
        part['travel'],
        tuple(part['goal_shares']),
    )
    arrays: dict[str, Any] = {
        name: _read_array(directory, part['arrays'][name], sub.shape, types)
        for name, types in SOLUTION_ARRAYS.items()
        if name != 'actions' or name in part['arrays']
    }
    return Solution(sub=sub, **arrays, **numbers(part, SOLUTION_FIELDS))


def _read_array(
    directory: Path, entry: dict[str, str], shape: tuple[int, ...], types: tuple[str, ...]
) -> AnyArray:
    file = directory / entry['file']
    try:
        content, digest = private_copy(file)
    except OSError as error:
        raise PolicyError(f'{shown(file)}: cannot be read: {why_not(error)}') from error
    if digest != entry['sha256']:
        raise PolicyError(
            f'{shown(file)}: sha256: does not match the manifest; the file was altered'
        )
    array = _as_array(content)
    if array.shape != shape or array.dtype not in types:
        raise PolicyError(f'{shown(file)}: {array.dtype} {array.shape} is not {types[0]} {shape}')
    return array


def _as_array(content: NDArray[np.uint8]) -> AnyArray:
    """Look at an `.npy` file's bytes as its array. Raises `ValueError`."""
    head = io.BytesIO(content[:MAX_HEADER_BYTES].tobytes())
    if np.lib.format.read_magic(head) != (1, 0):
        raise ValueError('version of .npy: is not 1.0')
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(head)
    numbers = np.asarray(content)[head.tell() :].view(dtype)
    return numbers.reshape(shape, order='F' if fortran else 'C')
