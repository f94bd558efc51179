"""Policy sets: what is saved is loaded, what is altered is refused, what is there is kept."""

from __future__ import annotations

import hashlib
import json
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import CASE_STUDY, case_study, missions, pick_states

from uav_mission_manager import build_policy, load_mission, load_policy
from uav_mission_manager.cli import policy_query
from uav_mission_manager.mdp import mission_from_dict
from uav_mission_manager.paths import share_directory
from uav_mission_manager.policy import METHODS, PolicyError

SHIPPED = share_directory() / 'policies' / 'case_study'


def contents(directory):
    return {path.name: path.read_bytes() for path in sorted(directory.iterdir())}


def refusal(directory, **arguments):
    """Return the one line of why a policy set is refused."""
    with pytest.raises(PolicyError) as error:
        load_policy(directory, **arguments)
    assert len(str(error.value).splitlines()) == 1
    return str(error.value)


@pytest.fixture(scope='module')
def original(tmp_path_factory):
    directory = tmp_path_factory.mktemp('sets') / 'p'
    build_policy(mission_from_dict(case_study(1, 2), 'test'), 'split').save(directory)
    return directory


@pytest.fixture
def copy(original, tmp_path):
    return shutil.copytree(original, tmp_path / 'p')


def test_shipped_set_is_the_exact_policy_of_the_shipped_mission(tmp_path):
    build_policy(load_mission(CASE_STUDY)).save(tmp_path / 'case_study')
    built, shipped = contents(tmp_path / 'case_study'), contents(SHIPPED)
    assert built.keys() == shipped.keys()
    assert [name for name in built if built[name] != shipped[name]] == []
    assert sum(map(len, shipped.values())) < 5e6


@pytest.mark.parametrize('method', [method for method in METHODS if method != 'auto'])
def test_loaded_is_saved(method, tmp_path):
    saved = build_policy(mission_from_dict(case_study(), 'test'), method, order=2)
    saved.save(tmp_path / 'p')
    loaded = load_policy(tmp_path / 'p')
    states = pick_states(saved.space, 3000)
    assert (loaded.mission, loaded.method, loaded.info) == (saved.mission, method, saved.info)
    assert loaded.plan == saved.plan
    for look in ('q_values', 'act', 'lower_bound', 'upper_bound', 'part_values'):
        np.testing.assert_array_equal(getattr(loaded, look)(states), getattr(saved, look)(states))
    assert loaded.decide(states[0].tolist()) == saved.decide(states[0].tolist())
    assert loaded.digest == json.loads((tmp_path / 'p' / 'manifest.json').read_text())['digest']


@settings(max_examples=10)
@given(missions([(1, 1), (2, 3)], [1, 2]))
def test_any_mission_comes_back_and_twice_the_same_bytes(tmp_path_factory, document):
    mission = mission_from_dict(document, 'test')
    directory = tmp_path_factory.mktemp('sets') / 'p'
    build_policy(mission).save(directory)
    before = contents(directory)
    assert load_policy(directory, mission=mission).mission == mission
    build_policy(mission).save(directory)
    assert contents(directory) == before


def test_flipped_bits_of_the_manifest(copy):
    """In every byte; bit 5 of each e also, for it turns 1e-08 into 1E-08, the same number."""
    manifest = copy / 'manifest.json'
    good = manifest.read_bytes()
    for at in range(len(good)):
        for bit in {at % 8, 5} if good[at] == ord('e') else {at % 8}:
            bad = bytearray(good)
            bad[at] ^= 1 << bit
            manifest.write_bytes(bad)
            assert refusal(copy).startswith(f'{manifest}: ')


@pytest.mark.parametrize('name', ['0_value', '1_value'])
def test_flipped_bits_of_an_array(copy, name):
    file = copy / f'{name}.npy'
    good = file.read_bytes()
    for at in [*range(0, 130, 7), len(good) // 2, len(good) - 1]:
        bad = bytearray(good)
        bad[at] ^= 1 << at % 8
        file.write_bytes(bad)
        assert refusal(copy).startswith(f'{file}: sha256: ')
    file.write_bytes(good)
    load_policy(copy)


@pytest.mark.parametrize('name', ['manifest.json', '0_value.npy', '1_value.npy'])
def test_truncated_empty_or_missing_file(copy, name):
    file = copy / name
    good = file.read_bytes()
    for part in (good[:-1], good[: len(good) // 2], b'', good + b'\0'):
        file.write_bytes(part)
        assert refusal(copy).startswith(f'{file}: ')
    file.unlink()
    assert refusal(copy).startswith(f'{file}: cannot be read: ')


def test_no_policy_set_at_all(tmp_path):
    for place in (tmp_path, tmp_path / 'nowhere', CASE_STUDY):
        assert refusal(place).startswith(f'{place}/manifest.json: cannot be read: ')


def forge(directory, change):
    """Alter the manifest and make its digest fit again, as another writer could have."""
    manifest = json.loads((directory / 'manifest.json').read_text())
    change(manifest)
    del manifest['digest']
    text = json.dumps(manifest, sort_keys=True)
    manifest['digest'] = hashlib.sha256(text.encode()).hexdigest()
    text = json.dumps(manifest, indent=1, sort_keys=True) + '\n'
    (directory / 'manifest.json').write_text(text)


FORGERIES = {
    'schema': lambda m: m.update(schema=3),
    'no schema': lambda m: m.pop('schema'),
    'mission_sha256': lambda m: m.update(mission_sha256='0' * 64),
    'changed mission': lambda m: m['mission'].update(discount=0.9),
    'bad mission': lambda m: m['mission'].update(discount=2),
    'no mission': lambda m: m.pop('mission'),
    'method': lambda m: m.update(method='magic'),
    'no sub-MDPs': lambda m: m.update(sub_mdps=[]),
    'no plan': lambda m: m.pop('plan'),
    'plan of another goal': lambda m: m['plan']['parts'][0].update(goals=['elsewhere']),
    'plan that leaves states out': lambda m: m['plan'].update(parts=m['plan']['parts'][:1]),
    'unknown goal': lambda m: m['sub_mdps'][0].update(goals=['elsewhere']),
    'unknown action': lambda m: m['sub_mdps'][0].update(actions=[1, 99]),
    'no such file': lambda m: m['sub_mdps'][1]['arrays']['value'].update(file='2_value.npy'),
    'no hash': lambda m: m['sub_mdps'][0]['arrays']['value'].pop('sha256'),
    'array of another kind': lambda m: m['sub_mdps'][0]['arrays'].update(
        actions=m['sub_mdps'][0]['arrays']['value']
    ),
    'sub-MDP of other goals': lambda m: m['sub_mdps'][0].update(goals=['goal1', 'goal2']),
}


@pytest.mark.parametrize('change', FORGERIES.values(), ids=FORGERIES)
def test_manifest_that_fits_itself_but_not_the_program(copy, change):
    forge(copy, lambda manifest: None)
    load_policy(copy)  # The forger's digest is right.
    forge(copy, change)
    assert refusal(copy).startswith(str(copy))


def test_policy_of_another_mission(copy):
    """Weights and probabilities may differ; what a command means on the ground may not."""
    load_policy(copy, mission=mission_from_dict(case_study(1, 2), 'test'))
    other_weights = case_study(1, 2, discount=0.9, name='other')
    other_weights['goals'][0]['eta'] = 99.0
    load_policy(copy, mission=mission_from_dict(other_weights, 'test'))
    moved, grid = case_study(1, 2), case_study()['grid']
    moved['goals'][0]['cell'] = 4
    others = {
        'goals': [case_study(1), case_study(2, 1), case_study(1, 3), moved],
        'grid': [
            case_study(1, 2, grid=grid | change)
            for change in (
                {'base': 4},
                {'service': 2},
                {'cols': 5},
                {'cell_size': 60.0},
                {'origin': grid['origin'] | {'latitude': 47.0}},
            )
        ],
    }
    for field, documents in others.items():
        for document in documents:
            message = refusal(copy, mission=mission_from_dict(document, 'test'))
            assert message.startswith(f'{copy}: mission.{field}: ')


@pytest.fixture
def policy():
    return build_policy(mission_from_dict(case_study(1), 'test'))


def assert_not_overwritten(policy, place):
    """Saving there is refused in one line, and nothing changes in the folder around it."""
    before = sorted(place.parent.rglob('*'))
    with pytest.raises(PolicyError) as error:
        policy.save(place)
    assert str(error.value).startswith(f'{place}: ')
    assert len(str(error.value).splitlines()) == 1
    assert sorted(place.parent.rglob('*')) == before


@pytest.mark.parametrize(
    'files',
    [['thesis.txt'], ['0_value.npy'], ['manifest.json', 'thesis.txt'], ['sub/manifest.json']],
)
def test_what_is_no_policy_set_is_not_overwritten(policy, tmp_path, files):
    place = tmp_path / 'p'
    for name in files:
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text('{"name": "my work"}')
    assert_not_overwritten(policy, place)


def test_a_file_or_below_a_file_is_no_place(policy, tmp_path):
    file = tmp_path / 'notes'
    file.write_text('mine')
    assert_not_overwritten(policy, file)
    with pytest.raises(PolicyError, match='cannot be written'):
        policy.save(file / 'p')
    assert file.read_text() == 'mine'


def test_saving_replaces_a_set_sound_or_broken(policy, copy):
    (copy / '0_value.npy').unlink()
    policy.save(copy)
    assert load_policy(copy).method == 'exact'
    assert sorted(path.name for path in copy.iterdir()) == ['0_value.npy', 'manifest.json']
    assert list(copy.parent.iterdir()) == [copy]


def test_saving_makes_the_folders_above_and_takes_an_empty_one(policy, tmp_path):
    for place in (tmp_path / 'a' / 'b' / 'p', tmp_path / 'empty'):
        (tmp_path / 'empty').mkdir(exist_ok=True)
        policy.save(place)
        assert load_policy(str(place)).digest == policy.digest


@pytest.mark.parametrize('failure', [OSError('disk full'), KeyboardInterrupt()], ids=repr)
def test_failed_save_leaves_the_old_set_and_nothing_else(policy, copy, monkeypatch, failure):
    before = contents(copy)
    save = np.save

    def save_and_fail(*arguments, **options):
        save(*arguments, **options)
        raise failure

    monkeypatch.setattr(np, 'save', save_and_fail)
    with pytest.raises((PolicyError, KeyboardInterrupt)) as error:
        policy.save(copy)
    assert isinstance(error.value, KeyboardInterrupt) or 'disk full' in str(error.value)
    assert contents(copy) == before
    assert list(copy.parent.iterdir()) == [copy]


def test_loaded_policy_outlives_its_set(policy, tmp_path):
    """The manager keeps deciding while the solver replaces the policy set under it."""
    policy.save(tmp_path / 'p')
    loaded = load_policy(tmp_path / 'p')
    build_policy(mission_from_dict(case_study(1, discount=0.5), 'test')).save(tmp_path / 'p')
    states = pick_states(policy.space, 500)
    np.testing.assert_array_equal(loaded.q_values(states), policy.q_values(states))


HOSTILE = {
    'long': 'x' * 100_000,
    'terminal': '\x1b[2J\n\u202e',
    'surrogate': '\ud800',
    'huge': 10**12,
    'huger': 10**400,
    'negative': -7,
    'fraction': 0.3,
    'not a number': float('nan'),
    'infinite': float('inf'),
    'true': True,
    'null': None,
    'empty list': [],
    'empty mapping': {},
    'many': [0] * 10_000,
    'nested': [[[[[[[[0]]]]]]]],
    'pairs': [[0, 10**12]],
    'mapping': {'x' * 100_000: '\ud800'},
}


def places(node, place=()):
    """Every field of a manifest, of lists the first entry."""
    for key, value in node.items() if isinstance(node, dict) else enumerate(node[:1]):
        yield (*place, key)
        if isinstance(value, (dict, list)):
            yield from places(value, (*place, key))


@pytest.fixture(scope='module', params=['exact', 'split', 'expansion'])
def any_set(request, tmp_path_factory):
    directory = tmp_path_factory.mktemp('sets') / 'p'
    mission = mission_from_dict(case_study(1, 2), 'test')
    build_policy(mission, request.param, order=1, certificate=True).save(directory)
    return directory


@pytest.mark.parametrize('name', HOSTILE)
def test_hostile_fields_of_the_manifest(any_set, name, capsys):
    """The set is refused in one short line, or what is said of it is not harmed.

    Each value is tried in a third of the fields, and each field with a third of the values.
    """
    first = list(HOSTILE).index(name) % 3
    manifest = any_set / 'manifest.json'
    good = manifest.read_text()

    def change(data):
        *above, last = place
        for key in above:
            data = data[key]
        data[last] = HOSTILE[name]

    try:
        for place in list(places(json.loads(good)))[first::3]:
            if place != ('digest',):
                manifest.write_text(good)
                forge(any_set, change)
                try:
                    assert policy_query.main([str(any_set), '--state=1,1,1,2,0,0,0,0,0']) == 0
                except SystemExit as ended:
                    line = str(ended.code)
                    assert line.startswith(f'policy_query: {any_set}')
                    assert line.isprintable()
                    assert len(line) <= 500 + len(str(any_set))
                out, errors = capsys.readouterr()
                assert errors == ''
                assert out.replace('\n', '').isprintable()
                assert len(out) < 10_000
    finally:
        manifest.write_text(good)


def test_manifest_nested_too_deeply(copy):
    (copy / 'manifest.json').write_text('[' * 100_000)
    assert refusal(copy).startswith(f'{copy}/manifest.json: not valid JSON: ')
