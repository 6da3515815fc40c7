"""How near two arrays are: by element, by norm, by direction, and on the average."""

import torch


def relative_error(got, want):
    """Norm of the difference of arrays or tensors, over the norm of `want`."""
    got, want = torch.as_tensor(got), torch.as_tensor(want)
    return float((got.to(want.dtype) - want).norm() / want.norm())


def assert_adjoint(x, image, y, back, *, ulp=20):
    """<y, A x> is <A* y, x> but for `ulp` roundings of |A x| |y|; their real parts, if x is real.

    x and `back` = A* y have one shape, y and `image` = A x another.
    """
    x, image, y, back = (torch.as_tensor(a).detach().reshape(-1) for a in (x, image, y, back))
    assert (image.dtype, back.dtype) == (y.dtype, x.dtype)
    wide = [a.to(torch.complex128) for a in (x, image, y, back)]
    difference = torch.vdot(wide[2], wide[1]) - torch.vdot(wide[3], wide[0])
    difference = difference if x.is_complex() else difference.real
    assert abs(difference) <= ulp * torch.finfo(y.dtype).eps * float(image.norm() * y.norm())


def assert_close(got, want, *, element, norm, cosine, bias):
    """Compare real or complex tensors; every limit is relative to the root mean square of `want`.

    element: largest difference; norm: difference of the norms; cosine: 1 - |cosine|; bias: mean
    difference, which random rounding averages away and a systematic error does not.
    """
    assert got.shape == want.shape
    got = got.to(want.dtype).reshape(-1)
    want = want.reshape(-1)
    rms = want.abs().pow(2).mean().sqrt()
    assert rms > 0
    difference = got - want
    found = {
        "element": float(difference.abs().max() / rms),
        "norm": float((got.norm() / want.norm() - 1.0).abs()),
        "cosine": float(1.0 - torch.vdot(got, want).abs() / (got.norm() * want.norm())),
        "bias": float(difference.mean().abs() / rms),
    }
    limits = {"element": element, "norm": norm, "cosine": cosine, "bias": bias}
    worse = {name: (found[name], limits[name]) for name in found if not found[name] <= limits[name]}
    assert not worse, f"(found, limit): {worse}"
