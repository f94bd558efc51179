"""What the documentation names exists: functions, files, links, anchors, commands."""

from __future__ import annotations

import ast
import re
import shlex
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODEL, THEORY, EXTENDING, REPRODUCE, README = (
    *(ROOT / 'docs' / f'{name}.md' for name in ('model', 'theory', 'extending', 'reproduce')),
    ROOT / 'README.md',
)
PAGES = [README, ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').glob('*.md'))]
FROM_ROOT = ('benchmarks/', 'test/', 'config/', 'launch/')
"""Where named files are below the repository's root; others are below the package."""

FILE = r'[\w/.-]+\.py'
FENCE = re.compile(r'^( *)```.*?^\1```', re.MULTILINE | re.DOTALL)
INLINE = re.compile(r'`([^`\n]+)`')
LINK = re.compile(r'\]\(([^)\s]+)\)')


def path_of(name: str) -> Path:
    return ROOT / name if name.startswith(FROM_ROOT) else ROOT / 'uav_mission_manager' / name


@cache
def names_in(path: Path) -> set[str]:
    """Functions, classes, their methods and attributes, and module variables of a file."""

    def below(nodes: list[ast.stmt], prefix: str) -> set[str]:
        found = set()
        for node in nodes:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                found.add(prefix + node.name)
            if isinstance(node, ast.ClassDef):
                found |= below(node.body, f'{prefix}{node.name}.')
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = (n for target in targets for n in ast.walk(target))
                found |= {prefix + name.id for name in names if isinstance(name, ast.Name)}
        return found

    return below(ast.parse(path.read_text(encoding='utf-8')).body, '')


def missing_names(text: str) -> list[str]:
    """`file.py` and `file.py:name` in backticks that do not exist."""
    missing = []
    for code in INLINE.findall(FENCE.sub('', text)):
        if match := re.fullmatch(rf'({FILE})(?::([\w.]+))?', code):
            path, name = path_of(match[1]), match[2]
            if not path.is_file() or (name and name not in names_in(path)):
                missing.append(code)
    return missing


def anchors(text: str) -> set[str]:
    """What links to the headings of a page end in, as GitHub makes it."""
    found: list[str] = []
    for heading in re.findall(r'^#+ +(.+?) *$', FENCE.sub('', text), re.MULTILINE):
        slug = re.sub(r'[^\w\- ]', '', LINK.sub(']', heading).lower()).replace(' ', '-')
        found.append(f'{slug}-{count}' if (count := found.count(slug)) else slug)
    return set(found)


def broken_links(page: Path, text: str) -> list[str]:
    """Relative links of a page to no file, or to no heading of one."""
    broken = []
    for link in LINK.findall(INLINE.sub('', FENCE.sub('', text))):
        if re.match(r'[a-z]+:', link):
            continue
        name, _, anchor = link.partition('#')
        target = page.parent / name if name else page
        page_text = target.read_text('utf-8') if name and anchor and target.exists() else text
        if not target.exists() or (anchor and anchor not in anchors(page_text)):
            broken.append(link)
    return broken


def table_commands(text: str) -> list[str]:
    """Commands in the tables whose last column is named `command`."""
    found = []
    for table in re.findall(r'(?:^\|.*\|\n)+', FENCE.sub('', text), re.MULTILINE):
        rows = [re.split(r'(?<!\\)\|', row) for row in table.splitlines()]
        head, _, *last = (row[-2].strip() for row in rows)
        if head == 'command':
            found += [command for command in last if command != '-']
    return found


@cache
def console_scripts() -> set[str]:
    """Names of the commands in setup.py."""
    body = ast.parse((ROOT / 'setup.py').read_text('utf-8')).body
    [commands] = [
        node.value
        for node in body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'COMMANDS'
    ]
    return set(ast.literal_eval(commands))


def starts(command: str) -> bool:
    """Whether a command, in backticks, starts with something that exists."""
    match = INLINE.fullmatch(command)
    program, *arguments = shlex.split(match[1]) if match else ['']
    if program in ('python', 'pytest', 'make') and not arguments:
        return False
    if program == 'python':
        return arguments[0].endswith('.py') and (ROOT / arguments[0]).is_file()
    if program == 'pytest':
        name, _, test = arguments[0].partition('::')
        return (ROOT / name).is_file() and (not test or test in names_in(ROOT / name))
    if program == 'make':
        makefile = (ROOT / 'Makefile').read_text('utf-8')
        rules = re.findall(r'^([\w-]+):', makefile, re.MULTILINE)
        variables = dict(argument.split('=', 1) for argument in arguments[1:])
        known = all(f'$({name})' in makefile for name in variables)
        scripts = variables.get('SCRIPTS', '').split()
        return arguments[0] in rules and known and all((ROOT / path).is_file() for path in scripts)
    given = [argument for argument in arguments if argument.startswith(('config/', 'policies/'))]
    return program in console_scripts() and all((ROOT / argument).exists() for argument in given)


@pytest.mark.parametrize(
    'page', [MODEL, THEORY, EXTENDING, REPRODUCE, README], ids=lambda page: page.name
)
def test_every_file_and_name_exists(page: Path) -> None:
    assert missing_names(page.read_text('utf-8')) == []


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_every_relative_link_resolves(page: Path) -> None:
    assert broken_links(page, page.read_text('utf-8')) == []


@pytest.mark.parametrize(('page', 'count'), [(MODEL, 50), (REPRODUCE, 20)])
def test_every_command_of_the_tables_exists(page: Path, count: int) -> None:
    found = table_commands(page.read_text('utf-8'))
    assert len(found) > count
    assert [command for command in found if not starts(command)] == []


LABELS = [
    'cost',
    'eq:SA_value',
    'eq:state_count',
    'eq:global_bellman',
    'eq:global_bellman_factored',
    'eq:expanded_global_bellman',
    'eq:local_bellman',
    'eq:additive_value',
    'eq:policy_concat',
    'local_cost',
    'table_2',
    'tab_scale',
    'tab:mdp_comparison',
    'table_3',
    'table_4',
    'algo1',
    'algo2',
    'thm:policy_equivalence',
    'BD_PF',
    'MDP',
    'scalability',
    'MDP_combine',
    'val_iter',
    'Num_case_1',
    'Xa',
    'Xb',
    'Xc',
    'Xd',
    'Decom_BD',
    'actioncalc_cmd',
    'submdp_action_policy',
    'fig:best_policy_submdp',
    'fig:action_choices_submdp',
    'fig:policy_agreement_both',
    'fig:policy_agreement_count',
    'fig:policy_agreement_percent',
    'fig:agreement_cmd',
    'state_mapping',
]
"""Labels of the paper's equations, tables, algorithms, theorem and figures."""


def test_the_table_has_every_label_and_number_of_the_paper() -> None:
    table = MODEL.read_text('utf-8').split('## From the paper to the code')[1]
    assert [label for label in LABELS if f'`{label}`' not in table] == []
    for what, last in (('Eq.', 14), ('Table', 5), ('Fig.', 12)):
        numbers = {int(n) for n in re.findall(rf'{re.escape(what)} \(?(\d+)', table)}
        absent = set(range(1, last + 1)) - numbers
        assert not absent, what


ALGORITHM_2 = (
    'sub-MDPs {M_1, .., M_N}',
    'local MDP solver',
    'completion thresholds C_j^min',
    'agent set with current states',
    'compute priority score rho_j',
    'sort sub-MDPs in descending order of rho_j into list L',
    'solve M_j (using Value Iteration) to obtain pi_j and V_j',
    'store pi_j and estimate expected reward R_j',
    'initialize E_j <- 0, C_j <- 0, agent queue A_j <- {}',
    'sort agents (e.g., based on previous assignments or proximity)',
    'add N_k to queue A_j',
    'if queue A_j meets minimal agent count',
    'assign a_k = pi_j(s_k)',
    'update E_j <- E[r_j({s_k}, {a_k})]',
    'if E_j >= C_j^min, set C_j <- 1',
    'combine actions from all sub-MDPs to form the overall joint policy',
    'for agents in multiple sub-MDPs, select action from the highest-priority sub-MDP',
    're-evaluate affected sub-MDPs and update policies',
    'return the joint global policy',
)
"""The lines of the paper's pseudocode."""


def test_every_line_of_algorithm_2_is_there_with_code_that_exists() -> None:
    section = MODEL.read_text('utf-8').split('### Algorithm 2 (`algo2`)')[1].split('###')[0]
    rows = [line for line in section.splitlines() if line.startswith('| ')][2:]
    for line in ALGORITHM_2:
        [row] = [row for row in rows if line in row]
        _, printed, here, difference, _, _ = re.split(r'(?<!\\)\|', row)
        assert line in printed
        assert difference.strip()
        named = [code for code in INLINE.findall(here) if re.fullmatch(rf'{FILE}:[\w.]+', code)]
        assert named
        assert missing_names(here) == []


@pytest.mark.parametrize(
    ('text', 'missing'),
    [
        ('`mdp/cost.py:StageCost.__call__`, `mdp/cost.py`, `test/brute_force.py:solve`', 0),
        ('`mdp/states.py:StateSpace.q`, `mdp/cost.py:RANGE_FLAGS`, `any.txt`, `a.b`', 0),
        ('`mdp/cost.py:no_such`', 1),
        ('`mdp/cost.py:StageCost.no_such`', 1),
        ('`mdp/cost.py:np`', 1),
        ('`mdp/no_such.py`', 1),
        ('`no_such/cost.py:StageCost`', 1),
    ],
)
def test_missing_names_are_found(text: str, missing: int) -> None:
    assert len(missing_names(text)) == missing


@pytest.mark.parametrize(
    ('text', 'broken'),
    [
        ('[a](theory.md) [b](https://example.org) `[c](no)` ![d](../README.md#commands)', 0),
        ('# One [more](theory.md), *twice*\n# Same\n# Same\n[a](#one-more-twice) [b](#same-1)', 0),
        ('[a](no_such.md)', 1),
        ('[a](theory.md#no-such)', 1),
        ('# Same\n[a](#same-1)', 1),
        ('```\n# comment\n```\n[a](#comment)', 1),
    ],
)
def test_broken_links_are_found(text: str, broken: int) -> None:
    assert len(broken_links(MODEL, text)) == broken


@pytest.mark.parametrize(
    ('command', 'exists'),
    [
        ('`make demo`', True),
        ('`make no_such`', False),
        ('`make bench SCRIPTS=benchmarks/paper.py`', True),
        ('`make bench SCRIPTS=benchmarks/no_such.py`', False),
        ('`make bench NO_SUCH=benchmarks/paper.py`', False),
        ("`make bench ARGS='--goals 4 --repeats 1'`", True),
        ('`python benchmarks/paper.py`', True),
        ('`python benchmarks/no_such.py`', False),
        ('`pytest test/unit/test_docs.py`', True),
        ('`pytest test/unit/test_docs.py::test_broken_links_are_found`', True),
        ('`pytest test/unit/test_docs.py::test_no_such`', False),
        ('`pytest test/unit/test_no_such.py`', False),
        ('`policy_build config/case_study.yaml --out build/x`', True),
        ('`policy_build config/no_such.yaml --out build/x`', False),
        ('`no_such --help`', False),
        ('make demo', False),
        ('`pytest`', False),
    ],
)
def test_commands_that_do_not_exist_are_found(command: str, exists: bool) -> None:
    row = f'| paper | here | command |\n| --- | --- | --- |\n| a \\| b | c | {command} |\n'
    assert table_commands(row) == [command]
    assert starts(command) == exists
