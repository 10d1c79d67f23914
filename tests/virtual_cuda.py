"""A GPU that is not there: tensors stay on the CPU and remember where they would be.

Within ``virtual_cuda()`` whatever mixes the two devices fails as it would on a real GPU. Only what
one thread does through Python is seen, so give tests ``engine.threads=1``. Kernels of CUDA are not
run, and nothing is said of speed or of rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves

CPU, CUDA = torch.device("cpu"), torch.device("cuda", 0)

_CROSSING = {Tensor.copy_, Tensor.__setitem__, Tensor.type_as, torch._foreach_copy_}
"""What a real GPU lets take numbers from the other device."""

_WITHOUT_NUMBERS = {
    torch._has_compatible_shallow_copy_type,
    Tensor.requires_grad_,
    Tensor.grad.__set__,
}
"""What looks at tensors and computes nothing."""


def is_there(tensor: Tensor) -> bool:
    """Whether a tensor would be on the GPU."""
    return getattr(tensor, "_is_on_gpu", False)


def put(result: Any, there: bool) -> Any:
    """Says of all tensors of a result where they are."""

    for tensor in tree_leaves(result):
        if isinstance(tensor, Tensor):
            tensor._is_on_gpu = there
    return result


def _is_gpu(device: Any) -> bool:
    return torch.device(device).type == "cuda"


def _moved(tensor: Tensor, there: bool, result: Tensor) -> Tensor:
    """``result``, as the copy on the device that a move leaves; the same where nothing moves."""
    if is_there(tensor) == there:
        return put(result, there)
    return put(result.clone() if result is tensor else result, there)


class _VirtualCuda(TorchFunctionMode):
    def __torch_function__(
        self, func: Callable, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        kwargs = dict(kwargs or {})
        for kind in types:
            if issubclass(kind, TensorDictBase):
                # It calls torch for each of its tensors.
                with self:
                    return kind.__torch_function__(func, types, args, kwargs)
        special = _SPECIAL.get(func)
        if special is not None:
            return special(func, *args, **kwargs)
        tensors = [one for one in tree_leaves((args, kwargs)) if isinstance(one, Tensor)]
        there = any(map(is_there, tensors))
        if kwargs.get("device") is not None:
            there = _is_gpu(kwargs["device"])
            generator = kwargs.get("generator")
            if there and generator is not None:
                raise RuntimeError("Expected a 'cuda' device type for generator but found 'cpu'")
            kwargs["device"] = CPU
        elif func in _CROSSING:
            there = is_there(tensors[0])
        elif func not in _WITHOUT_NUMBERS:
            _check_together(func, tensors)
        return put(func(*args, **kwargs), there)


def _check_together(func: Callable, tensors: list[Tensor]) -> None:
    """Numbers without dimensions may come from the CPU; all else is on one device."""
    away = [one for one in tensors if not is_there(one) and one.dim() > 0]
    if away and len(away) < len(tensors) and any(map(is_there, tensors)):
        raise RuntimeError(
            "Expected all tensors to be on the same device, but found at least two devices, cuda:0"
            f" and cpu, in {getattr(func, '__name__', func)}: on the CPU"
            f" {[tuple(one.shape) for one in away]}"
        )


def _to(func: Callable, tensor: Tensor, *args: Any, **kwargs: Any) -> Tensor:
    there = is_there(tensor)
    plain = []
    for arg in args:
        if isinstance(arg, torch.device | str):
            there, arg = _is_gpu(arg), CPU
        elif isinstance(arg, Tensor):
            there = is_there(arg)
        plain.append(arg)
    if kwargs.get("device") is not None:
        there, kwargs["device"] = _is_gpu(kwargs["device"]), CPU
    return _moved(tensor, there, func(tensor, *plain, **kwargs))


def _get(func: Callable, tensor: Tensor, index: Any) -> Tensor:
    """Indices may come from the CPU, but not from the GPU to it."""
    of = [one for one in tree_leaves(index) if isinstance(one, Tensor)]
    if not is_there(tensor) and any(map(is_there, of)):
        raise RuntimeError("indices should be either on cpu or on the same device (cpu)")
    return put(func(tensor, index), is_there(tensor))


def _to_numpy(func: Callable, tensor: Tensor, *args: Any, **kwargs: Any) -> Any:
    if is_there(tensor):
        raise TypeError("can't convert cuda:0 device type tensor to numpy")
    return func(tensor, *args, **kwargs)


def _set_data(func: Callable, tensor: Tensor, data: Tensor) -> None:
    func(tensor, data)
    put(tensor, is_there(data))


def _copied(func: Callable, tensor: Tensor, *args: Any, **kwargs: Any) -> Tensor:
    return put(func(tensor, *args, **kwargs), is_there(tensor))


_SPECIAL: dict[Any, Callable] = {
    Tensor.device.__get__: lambda func, x, *_: CUDA if is_there(x) else CPU,
    Tensor.is_cuda.__get__: lambda func, x, *_: is_there(x),
    Tensor.data.__set__: _set_data,
    Tensor.to: _to,
    Tensor.cpu: lambda func, x, **how: _moved(x, False, func(x, **how)),
    Tensor.cuda: lambda func, x, *_, **__: _moved(x, True, x),
    Tensor.__getitem__: _get,
    Tensor.numpy: _to_numpy,
    Tensor.__array__: _to_numpy,
    Tensor.__deepcopy__: _copied,
    nn.Parameter.__deepcopy__: _copied,
}


@contextmanager
def virtual_cuda() -> Iterator[None]:
    """A machine with one GPU, for code that asks torch for it in this thread."""
    made: Any = nn.Parameter.__new__

    def parameter(cls: type, data: Any = None, requires_grad: bool = True) -> nn.Parameter:
        return put(made(cls, data, requires_grad), data is not None and is_there(data))

    answers: dict[str, Any] = {
        "is_available": lambda: True,
        "device_count": lambda: 1,
        "current_device": lambda: 0,
        "synchronize": lambda *_: None,
        "_lazy_init": lambda: None,
        "is_bf16_supported": lambda **_: False,
        "is_current_stream_capturing": lambda: False,
        "get_rng_state": lambda *_: torch.get_rng_state(),
        "set_rng_state": lambda *_: None,
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, answer in answers.items():
            patch.setattr(torch.cuda, name, answer)
        patch.setattr(nn.Parameter, "__new__", parameter)
        with _VirtualCuda():
            yield
