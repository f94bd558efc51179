"""A stand-in for CuPy, for tests without a card: NumPy, but for what CuPy refuses.

It knows only what the solver uses, each as CuPy 13 and 14 have it: arguments that CuPy lacks, such
as `mode` of `take` or `where` of a ufunc, are errors here. Beyond CuPy, it refuses what would be
slow there: an argument that shares memory with a result and is not the same array, which CuPy
copies, and a reshape that is a copy. Room not written yet holds NaN. It counts the memory in use.
Expressions of `ElementwiseKernel` are compiled by the machine's own C++ compiler.
"""

from __future__ import annotations

import ctypes
import functools
import math
import subprocess
import tempfile
import weakref
from pathlib import Path
from types import SimpleNamespace

import numpy as np

UFUNCS = {'add', 'subtract', 'multiply', 'minimum', 'absolute', 'less_equal', 'equal'}
SCALARS = (bool, int, float, np.generic)
ITEMS = (int, slice, type(None), type(Ellipsis))

memory = SimpleNamespace(used=0, most=0, total=1 << 40)
"""Bytes in use, the most there were, and those of the card."""


class Array(np.lib.mixins.NDArrayOperatorsMixin):
    """An array of the card: a view of `host`, which only this module looks at."""

    def __init__(self, host, base=None):
        self.host, self.base = host, base
        if base is None:
            memory.used += host.nbytes
            memory.most = max(memory.most, memory.used)
            weakref.finalize(self, _freed, host.nbytes)

    def __array__(self, dtype=None, copy=None):
        raise TypeError('Implicit conversion to a NumPy array is not allowed.')

    def __array_ufunc__(self, ufunc, method, *inputs, out=(None,), **how):
        if how or method != '__call__' or ufunc.__name__ not in UFUNCS:
            raise TypeError(f'CuPy has no {ufunc.__name__}.{method} with {sorted(how)}')
        (into,) = out
        arguments = [_argument(x) for x in inputs]
        if into is None:
            return Array(ufunc(*arguments))
        for x in inputs:
            _refuse_overlap(x, into)
        ufunc(*arguments, out=_host(into))
        return into

    def __array_function__(self, function, types, args, how):
        if function not in FUNCTIONS or not all(issubclass(kind, Array) for kind in types):
            raise TypeError(f'CuPy has no {function.__name__} of {types}')
        return FUNCTIONS[function](*args, **how)

    def __getitem__(self, key):
        return Array(self.host[_checked(key)], self._owner)

    def __setitem__(self, key, value):
        if isinstance(value, Array):
            raise AssertionError('copies once more than copyto')
        self.host[_checked(key)] = _argument(value)

    def __len__(self):
        return len(self.host)

    def __iter__(self):
        return (self[i] for i in range(len(self)))

    def __float__(self):
        return float(self.host)

    def reshape(self, *shape):
        return self._view(self.host.reshape(*shape))

    def transpose(self, *axes):
        return self._view(self.host.transpose(*axes))

    @property
    def T(self):  # noqa: N802  # Its name.
        return self.transpose()

    @property
    def _owner(self):
        return self if self.base is None else self.base

    def _view(self, host):
        assert np.shares_memory(host, self.host), 'this copies'
        return Array(host, self._owner)

    def take(self, indices, axis=None, out=None):
        assert out.dtype == self.dtype
        assert self.host.flags.c_contiguous, 'this copies'
        self.host.take(_host(indices), axis, _host(out), 'wrap')
        return out

    def fill(self, value):
        self.host.fill(_argument(value))

    def min(self):
        return Array(np.array(self.host.min()))

    def max(self):
        return Array(np.array(self.host.max()))

    shape = property(lambda self: self.host.shape)
    dtype = property(lambda self: self.host.dtype)
    size = property(lambda self: self.host.size)
    ndim = property(lambda self: self.host.ndim)


class ElementwiseKernel:
    """An expression in C++, evaluated for each entry of the arrays that are not raw."""

    def __init__(self, in_params, out_params, operation, name='kernel', *, options=()):
        assert '--fmad=false' in options, 'other bits than those of NumPy'
        params = [param.split() for param in f'{in_params}, {out_params}'.split(',')]
        self.params = tuple((param[0] == 'raw', param[-2], param[-1]) for param in params)
        self.inputs = len(in_params.split(','))
        self.operation = operation

    def __call__(self, *arguments):
        taken = list(zip(self.params, arguments, strict=True))
        (dtype,) = {x.dtype for (_, kind, _), x in taken if kind == 'T' and isinstance(x, Array)}
        shapes = [x.shape for (raw, *_), x in taken if isinstance(x, Array) and not raw]
        shape, passed, results, kept = np.broadcast_shapes(*shapes), [], [], []
        for place, ((raw, kind, _), x) in enumerate(taken):
            expected = dtype if kind == 'T' else np.dtype(kind)
            if not isinstance(x, Array):
                passed.append(np.ctypeslib.as_ctypes_type(expected)(x))
                continue
            assert x.dtype == expected
            host = x.host
            if place >= self.inputs:
                assert host.shape == shape, 'Out shape is mismatched'
                host = host.copy()
                results.append((x.host, host))
            elif raw:
                assert host.flags.c_contiguous, 'a flat index is slow there'
            else:
                host = np.ascontiguousarray(np.broadcast_to(host, shape))
            passed.append(ctypes.c_void_p(host.ctypes.data))
            kept.append(host)
        are_arrays = tuple(isinstance(x, Array) for x in arguments)
        run = _compiled(self.params, are_arrays, self.operation, C_TYPES[dtype.name])
        run(ctypes.c_ssize_t(math.prod(shape)), *passed)
        for into, result in results:
            into[...] = result


C_TYPES = {
    'float32': 'float',
    'float64': 'double',
    'uint32': 'unsigned int',
    'int32': 'int',
    'uint8': 'unsigned char',
}


@functools.cache
def _compiled(params, are_arrays, operation, real):
    """Compile the loop over all entries."""
    given, entries = [], []
    for (raw, kind, name), is_array in zip(params, are_arrays):
        kind = real if kind == 'T' else C_TYPES[kind]
        given.append(f'{kind}* {"" if raw else "_"}{name}' if is_array else f'{kind} {name}')
        if is_array and not raw:
            entries.append(f'{kind}& {name} = _{name}[i];')
    code = f"""
        #include <cstddef>
        typedef {real} T;
        extern "C" void run(ptrdiff_t size, {', '.join(given)}) {{
            for (ptrdiff_t i = 0; i < size; ++i) {{ {' '.join(entries)} {operation} }}
        }}
    """
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / 'steps.so'
        how = '-x', 'c++', '-', '-shared', '-fPIC', '-O1', '-ffp-contract=off', '-o', library
        subprocess.run(['c++', *how], input=code, text=True, check=True)
        return ctypes.CDLL(str(library)).run


def _freed(count):
    memory.used -= count


def _host(array):
    if not isinstance(array, Array):
        raise TypeError(f'{type(array)} is no array of the card')
    return array.host


def _argument(value):
    """An operand: an array of the card or a scalar, but no array of NumPy's, not even of none."""
    return value if type(value) in SCALARS[:3] or isinstance(value, np.generic) else _host(value)


def _checked(key):
    keys = key if isinstance(key, tuple) else (key,)
    if not all(isinstance(item, ITEMS) for item in keys):
        raise TypeError(f'indices {key!r} are on the machine')
    return key


def _refuse_overlap(source, into):
    """Refuse what `cupy._core._memory_range.may_share_bounds` makes CuPy copy."""
    if isinstance(source, Array) and source is not into and source._owner is into._owner:
        assert not np.may_share_memory(source.host, into.host, max_work=0), 'this copies'


def _copyto(into, source, casting='same_kind', where=None):
    _refuse_overlap(source, into)
    chosen = {} if where is None else {'where': _host(where)}
    np.copyto(_host(into), _argument(source), casting, **chosen)


def _concatenate(arrays, axis=0):
    return Array(np.concatenate([_host(array) for array in arrays], axis))


FUNCTIONS = {
    np.copyto: _copyto,
    np.empty_like: lambda like: empty(like.shape, like.dtype),
    np.zeros_like: lambda like, dtype: zeros(like.shape, dtype),
    np.concatenate: _concatenate,
}


def empty(shape, dtype=float):
    return Array(np.full(shape, np.nan, dtype))


def zeros(shape, dtype=float):
    return Array(np.zeros(shape, dtype))


def array(values, dtype=None):
    return Array(np.array(values.host if isinstance(values, Array) else values, dtype))


def asarray(values):
    return values if isinstance(values, Array) else array(values)


def asnumpy(values):
    return _host(values).copy()


cuda = SimpleNamespace(
    runtime=SimpleNamespace(memGetInfo=lambda: (memory.total - memory.used, memory.total))
)


def get_default_memory_pool():
    return SimpleNamespace(free_bytes=lambda: 0, free_all_blocks=lambda: None)
