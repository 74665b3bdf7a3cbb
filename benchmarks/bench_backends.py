"""Times a retargeter's call in NumPy against the same map compiled by numba and run by ONNX Runtime.

python benchmarks/bench_backends.py --json backends.json

Needs `pip install numba onnx onnxruntime`. All sides check shape and finiteness, and their results are
compared. The numba side is `load_retargeter(path, backend="numba")`, which compiles before its first run on a
machine.
"""

import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from side_by_side import measure, parse, parser, report
from untrained import FORMS, dense_layers, untrained

from geort_drake.console import console, run_main
from geort_drake.errors import GeortError


def main(argv: Sequence[str] | None = None) -> int:
    options = parser(__doc__)
    options.add_argument("--method", choices=FORMS, default=FORMS[0], help="(default: %(default)s)")
    arguments = parse(options, argv)
    retarget = untrained(arguments.method)
    layers = dense_layers(arguments.method)
    try:
        started = time.perf_counter()
        compiled = untrained(arguments.method)
        compiled.compile()
        loading = time.perf_counter() - started
        sides = {
            "NumPy": retarget,
            "numba": compiled,
            "ONNX Runtime, float64": with_onnx(*layers, np.float64),
            "ONNX Runtime, float32": with_onnx(*layers, np.float32),
        }
    except ImportError as error:
        raise GeortError(f"{error}: this benchmark needs pip install numba onnx onnxruntime") from error
    p_HF = np.random.default_rng(1).normal(0.0, 0.03, (4, 3))
    results = measure({name: lambda side=side: side(p_HF) for name, side in sides.items()}, arguments.seconds)
    apart = {name: float(np.abs(side(p_HF) - retarget(p_HF)).max()) for name, side in sides.items()}
    title = f"one call of {arguments.method} by several backends"
    report(title, results, "NumPy", arguments.json, apart_rad=apart, numba_loading_s=loading)
    console.print(f"apart from NumPy by at most (rad): {apart}; numba was ready after {loading:.1f} s")
    return 0


def with_onnx(
    weights, biases, own: np.ndarray, residual: np.ndarray, dtype
) -> Callable[[np.ndarray], np.ndarray]:
    """Returns a call of an ONNX Runtime session with one thread."""
    import onnxruntime
    from onnx import helper, numpy_helper

    kind = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
    count, width = own.shape[:2]
    constants = {
        "w0": weights[0], "b0": biases[0], "w1": own, "b1": biases[1], "w2": weights[1], "b2": biases[2],
        "r1": residual,
    }  # fmt: skip
    integers = {
        "sizes": np.array([count * width, len(residual)]),
        "apart": np.array([count, 1, width]),
        "together": np.array([1, count * width]),
    }
    node = helper.make_node
    nodes = [
        node("Gemm", ["x", "w0", "b0"], ["a"]), node("Sigmoid", ["a"], ["s"]), node("Mul", ["a", "s"], ["h"]),
        node("Split", ["h", "sizes"], ["h_own", "h_shared"], axis=1),
        node("Reshape", ["h_own", "apart"], ["h_apart"]), node("MatMul", ["h_apart", "w1"], ["u_apart"]),
        node("Reshape", ["u_apart", "together"], ["u_own"]), node("MatMul", ["h_shared", "r1"], ["u_shared"]),
        node("Concat", ["u_own", "u_shared"], ["u0"], axis=1), node("Add", ["u0", "b1"], ["u"]),
        node("Sigmoid", ["u"], ["t"]), node("Mul", ["u", "t"], ["v"]),
        node("Gemm", ["v", "w2", "b2"], ["y"]), node("Tanh", ["y"], ["q"]),
    ]  # fmt: skip
    if not residual.size:
        nodes[3:9] = [nodes[4], nodes[5], node("Reshape", ["u_apart", "together"], ["u0"])]
        nodes[3] = node("Reshape", ["h", "apart"], ["h_apart"])
        del constants["r1"], integers["sizes"]
    tensors = [
        numpy_helper.from_array(np.ascontiguousarray(a.astype(dtype)), n) for n, a in constants.items()
    ]
    tensors += [numpy_helper.from_array(a, name) for name, a in integers.items()]
    x, q = (
        helper.make_tensor_value_info("x", kind, [1, 12]),
        helper.make_tensor_value_info("q", kind, [1, 16]),
    )
    model = helper.make_model(
        helper.make_graph(nodes, "retargeter", [x], [q], tensors),
        opset_imports=[helper.make_opsetid("", 17)],
        ir_version=8,
    )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    providers = ["CPUExecutionProvider"]
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=providers)

    def call(p_HF: np.ndarray) -> np.ndarray:
        p_HF = np.asarray(p_HF, dtype=dtype)
        if p_HF.shape != (4, 3) or not math.isfinite(p_HF.sum()):
            raise ValueError(p_HF)
        return session.run(None, {"x": p_HF.reshape(1, 12)})[0][0]

    return call


if __name__ == "__main__":
    run_main(main)
