"""Loss terms with their own derivatives against torch's autograd in float64, on every kernel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional

from mgsr.data.camera import Camera
from mgsr.errors import TensorError
from mgsr.native import _terms
from mgsr.ops.depth_normals import normal_agreement_term
from mgsr.ops.image_loss import image_loss_term
from mgsr.ops.pixels import composite, covered, product_term, silhouette_term, squares_term, steps_term
from mgsr.ops.terms import Term, evaluate, scalar
from mgsr.ops.tv import edge_aware_tv_term
from tests.cuda.machines import PROCESSOR, Machine, on_every_kernel
from tests.ops.variants import ISAS, variant
from tests.oracles import depth_normals as normals_oracle
from tests.oracles import image_loss as loss_oracle
from tests.oracles import tv as tv_oracle

HEIGHT, WIDTH = 19, 23
LARGE = 151, 173  # more pixels than a task of the CPU's kernels takes, and no multiple of a vector


def random(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def some(*shape: int, seed: int = 0) -> Tensor:
    """Draw zeros and ones."""
    return (random(*shape, seed=seed) > 0.4).float()


def compare(
    machine: Machine, term: Callable[..., Term], oracle: Callable[..., Tensor], *inputs: Tensor, tolerance: float = 1e-5
) -> None:
    """Compare a term of inputs on a machine, and its gradients, with a function of torch's in float64."""
    leaves = [each.clone().to(machine.device).requires_grad_() for each in inputs]
    twins = [each.double().requires_grad_() for each in inputs]
    with machine.running():
        value = scalar(3.0 * term(*leaves))
        (0.5 * value).backward()
    expected = 3.0 * oracle(*twins)
    (0.5 * expected).backward()
    assert float(value.detach()) == pytest.approx(float(expected.detach()), rel=tolerance, abs=1e-7)
    for leaf, twin in zip(leaves, twins, strict=True):
        assert leaf.grad is not None and twin.grad is not None
        assert (leaf.grad.cpu().double() - twin.grad).abs().max() <= tolerance * twin.grad.abs().max()


@on_every_kernel
@pytest.mark.parametrize("weighted", [False, True])
def test_silhouettes(machine: Machine, weighted: bool) -> None:
    mask, weights = some(HEIGHT, WIDTH, seed=1), some(HEIGHT, WIDTH, seed=2) if weighted else torch.ones(HEIGHT, WIDTH)
    given = weights.to(machine.device) if weighted else None
    alpha = random(HEIGHT, WIDTH)
    compare(
        machine,
        lambda a: silhouette_term(a, mask.to(machine.device), given),
        lambda a: ((a - mask.double()) * weights.double()).abs().mean(),
        alpha,
    )
    alpha[0, :3] = torch.tensor([0.0, 1.0, 1e-5])  # clamped, without a gradient
    compare(
        machine,
        lambda a: silhouette_term(a, mask.to(machine.device), given, entropy=True),
        lambda a: functional.binary_cross_entropy((a * weights).clamp(1e-4, 1 - 1e-4), (mask * weights).double()),
        alpha,
        tolerance=1e-4,  # 1 - alpha in float32, near 1
    )


@on_every_kernel
def test_squares(machine: Machine) -> None:
    a, b = random(HEIGHT, WIDTH), random(HEIGHT, WIDTH, seed=1)
    first, second = some(HEIGHT, WIDTH, seed=2), some(HEIGHT, WIDTH, seed=3)
    weights = first.to(machine.device), second.to(machine.device)
    divisor = torch.tensor(7.0, device=machine.device)
    compare(
        machine,
        lambda x, y: squares_term(x, y, weights, by=divisor),
        lambda x, y: ((x - y) * first * second).square().sum() / 7,
        *(a, b),
    )
    compare(machine, lambda x: squares_term(x, offset=0.3, by=2.0), lambda x: (x - 0.3).square().sum() / 2, a)


@on_every_kernel
def test_products(machine: Machine) -> None:
    inputs = random(HEIGHT, WIDTH), random(HEIGHT, WIDTH, 3, seed=1)
    compare(machine, product_term, lambda w, c: (w[..., None] * c).mean(), *inputs)


def steps_oracle(maps: Tensor) -> Tensor:
    return maps.diff(dim=1).square().mean() + maps.diff(dim=2).square().mean()


@on_every_kernel
def test_steps_of_maps(machine: Machine) -> None:
    compare(machine, steps_term, steps_oracle, random(2, 5, 5, 3))
    with machine.running():
        assert float(steps_term(torch.ones(2, 1, 1, 3, device=machine.device))) == 0


@on_every_kernel
def test_agreement_of_normals(machine: Machine) -> None:
    K, pose = np.array([[20.0, 0, 11], [0, 22.0, 9], [0, 0, 1]]), np.eye(4)
    camera = Camera(K, pose, WIDTH, HEIGHT)
    depth = 2 + 0.1 * random(HEIGHT, WIDTH)
    depth[4, 5] = 0  # no normal there, nor beside it
    normals, alpha, where = random(HEIGHT, WIDTH, 3, seed=1) - 0.5, random(HEIGHT, WIDTH, seed=2), some(HEIGHT, WIDTH)

    def oracle(n: Tensor, d: Tensor) -> Tensor:
        from_depth = normals_oracle.depth_to_normals(d, torch.from_numpy(K), torch.from_numpy(pose))
        along = (n * from_depth * (alpha * where).double()[..., None]).sum(dim=-1)
        return (where - along).sum() / where.sum()

    compare(
        machine,
        lambda n, d: normal_agreement_term(n, d, camera, alpha.to(machine.device), where.to(machine.device)),
        oracle,
        *(normals, depth),
        tolerance=2e-5,
    )


@on_every_kernel
def test_a_clipped_image_costs_nothing_over_white(machine: Machine) -> None:
    image, target = 1.5 * random(HEIGHT, WIDTH, 3), random(HEIGHT, WIDTH, 3, seed=1)
    image[:7], target[:7] = 1.2, 1.0
    compare(
        machine,
        lambda i: image_loss_term(i, target.to(machine.device), 0.8, clip=True),
        lambda i: loss_oracle.image_loss(i.clamp(max=1), target.double(), 0.8),
        image,
        tolerance=2e-5,
    )


@on_every_kernel
def test_many_terms_of_one_image_add_up(machine: Machine) -> None:
    """Check that more terms of one image add up than a kernel takes at once.

    Some are of one number a pixel; and some images are in none of them.
    """
    image, weight, target = random(HEIGHT, WIDTH, 3), random(HEIGHT, WIDTH, seed=1), random(HEIGHT, WIDTH, 3, seed=2)
    leaves = [each.clone().to(machine.device).requires_grad_() for each in (image, weight)]
    exact = [each.double().requires_grad_() for each in (image, weight)]
    with machine.running():
        same = target.to(machine.device)
        terms = [0.5 * image_loss_term(leaves[0], same, 0.8), product_term(leaves[1], leaves[0])]
        terms += [index * edge_aware_tv_term(leaves[0], same) for index in range(1, 6)]
        terms += [squares_term(leaves[0][:, :, 0].contiguous(), by=HEIGHT * WIDTH)]
        values = evaluate(terms)
        factors = torch.arange(1.0, len(terms) + 1, device=machine.device)
        (values * factors).sum().backward()
    expected = [0.5 * loss_oracle.image_loss(exact[0], target.double(), 0.8), (exact[1][..., None] * exact[0]).mean()]
    expected += [index * tv_oracle.edge_aware_tv(exact[0], target.double(), None) for index in range(1, 6)]
    expected += [exact[0][..., 0].square().mean()]
    torch.stack([(index + 1) * term for index, term in enumerate(expected)]).sum().backward()
    assert values.detach().cpu().double().numpy() == pytest.approx(torch.stack(expected).detach().numpy(), rel=2e-5)
    for leaf, twin in zip(leaves, exact, strict=True):
        assert leaf.grad is not None and twin.grad is not None
        assert (leaf.grad.cpu().double() - twin.grad).abs().max() <= 2e-5 * twin.grad.abs().max()


@on_every_kernel
def test_a_term_without_gradients_has_its_value(machine: Machine) -> None:
    image = random(HEIGHT, WIDTH, 3).to(machine.device)
    with machine.running():
        leaf = image.clone().requires_grad_()
        assert float(product_term(image[..., 0].contiguous(), image)) == pytest.approx(
            float((image[..., :1] * image).mean()), rel=1e-5
        )
        with torch.no_grad():
            assert not product_term(leaf[..., 0].contiguous(), leaf).slopes


@on_every_kernel
@pytest.mark.parametrize("masked", [False, True])
def test_coverage(machine: Machine, masked: bool) -> None:
    alpha, mask = torch.tensor([[0.4, 0.5, 0.6, 1.0]]), torch.tensor([[1.0, 1.0, 0.6, 0.5]])
    with machine.running():
        result = covered(alpha.to(machine.device), mask.to(machine.device) if masked else None)
    assert result.tolist() == [[0.0, 0.0, 1.0, 0.0 if masked else 1.0]]


@on_every_kernel
def test_a_photograph_on_a_colour(machine: Machine) -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.randint(0, 256, (HEIGHT, WIDTH, 3), dtype=torch.uint8, generator=generator)
    mask = torch.randint(0, 256, (HEIGHT, WIDTH), dtype=torch.uint8, generator=generator)
    off_edge, background = mask > 100, torch.tensor([0.2, 0.5, 0.9])
    on_machine = [each.to(machine.device) for each in (image, mask, background, off_edge)]
    picture, opacity, behind, off = on_machine
    with machine.running():
        color, alpha, weights = composite(picture, opacity, behind, off)
    share = mask.double() / 255
    expected = share[..., None] * image.double() / 255 + (1 - share[..., None]) * background.double()
    assert (color.cpu().double() - expected).abs().max() < 1e-6
    assert (alpha.cpu().double() - share).abs().max() < 1e-7
    assert weights is not None and torch.equal(weights.cpu(), off_edge.float())


@pytest.mark.parametrize("isa", ISAS)
def test_large_images_on_every_variant(isa: str) -> None:
    a, b, mask = random(*LARGE), random(*LARGE, seed=1), some(*LARGE, seed=2)
    color, behind = random(*LARGE, 3, seed=3), torch.tensor([0.2, 0.5, 0.9])
    with variant(_terms, isa):
        compare(PROCESSOR, lambda x: silhouette_term(x, mask, b), lambda x: ((x - mask) * b).abs().mean(), a)
        compare(PROCESSOR, lambda x, y: squares_term(x, y), lambda x, y: (x - y).square().sum(), a, b)
        compare(PROCESSOR, product_term, lambda w, c: (w[..., None] * c).mean(), a, color)
        compare(PROCESSOR, steps_term, steps_oracle, random(2, 33, 33, 3))
        assert torch.equal(covered(a, b), ((a > 0.5) & (b > 0.5)).float())
        picture, opacity = (255 * color).byte(), (255 * a).byte()
        got, _, _ = composite(picture, opacity, behind)
    expected = behind + (picture / 255 - behind) * (opacity / 255)[..., None]
    assert (got - expected).abs().max() < 1e-6


def test_same_bytes_for_any_thread_count() -> None:
    image, weight = random(*LARGE, 3), random(*LARGE, seed=1)
    results = []
    for threads in (1, 2, 5):
        leaves = image.clone().requires_grad_(), weight.clone().requires_grad_()
        with variant(_terms, threads=threads):
            total = evaluate([product_term(leaves[1], leaves[0]), squares_term(leaves[0]), squares_term(leaves[1])])
            total.sum().backward()
        gradients = [leaf.grad for leaf in leaves if leaf.grad is not None]
        results.append([total.detach(), *gradients])
    for other in results[1:]:
        assert len(other) == 3 and all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_wrong_shapes_are_named() -> None:
    plane = torch.zeros(4, 5)
    with pytest.raises(TensorError, match=r"mask: expected \[H=4, W=5\], got \[4, 4\]"):
        silhouette_term(plane, plane[:, :4])
    with pytest.raises(TensorError, match=r"b: expected \[4, 5\], got \[3, 5\]"):
        squares_term(plane, plane[:3])
    with pytest.raises(TensorError, match=r"color: expected \[H=4, W=5, 3\]"):
        product_term(plane, plane)
