"""How many copies she misses at least: exact tails, bursts, schedules."""

from fractions import Fraction
from math import comb

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import beta, binom

from protocol.gilbert_elliott import GilbertElliott
from protocol.secret.blocks import schedule_of
from protocol.secret.bound import Assumption, quantile
from protocol.statistics import clopper_pearson


def exact_tail(n: int, e: Fraction, m: int) -> Fraction:
    return sum((comb(n, k) * e**k * (1 - e) ** (n - k) for k in range(m)), Fraction(0))


@pytest.mark.parametrize("e", ["1/100", "1/10", "3/10", "1/2"])
def test_the_quantile_turns_where_the_exact_tail_does_but_for_its_guard(e: str) -> None:
    """The guard is 1e-9; what the sum is off by is below a fiftieth of that."""
    for m in (1, 5, 20, 60):
        exact = float(exact_tail(128, Fraction(e), m))
        if exact < 0.9:
            share = float(Fraction(e))
            assert quantile(128, share, exact * (1 + 1.02e-9)) == m
            assert quantile(128, share, exact * (1 + 0.98e-9)) == m - 1


@given(
    n=st.integers(1, 3000),
    e=st.floats(0, 1),
    eps=st.sampled_from([1e-3, 1e-9, 1e-12]),
)
def test_the_quantile_is_where_the_tail_crosses_eps(n: int, e: float, eps: float) -> None:
    q = quantile(n, e, eps)
    assert 0 <= q <= n
    assert binom.cdf(q - 1, n, e) <= eps * (1 + 1e-9)
    if q < n:
        assert binom.cdf(q, n, e) >= eps * (1 - 1e-6)


@given(n=st.integers(1, 500), e=st.floats(0.01, 0.9))
def test_the_quantile_is_monotone_and_nothing_claimed_is_nothing(n: int, e: float) -> None:
    q = quantile(n, e, 1e-9)
    assert quantile(n, e, 1e-12) <= q <= quantile(n + 1, e, 1e-9)
    assert q <= quantile(n, min(1.0, e + 0.05), 1e-9)
    assert quantile(n, 0.0, 1e-12) == 0


def test_the_quantile_refuses_what_is_no_probability() -> None:
    with pytest.raises(ValueError, match=r"^e: got 1\.5, expected 0 to 1$"):
        quantile(10, 1.5, 1e-12)
    with pytest.raises(ValueError, match=r"^eps: got 0, expected between 0 and 1$"):
        quantile(10, 0.5, 0)


def test_rows_are_what_is_missed_less_what_was_lost() -> None:
    claim = Assumption(0.3)
    assert claim.rows(transitions=256, steps=256, counted=512) == 85
    assert claim.rows(transitions=256, steps=260, counted=515) == 80
    assert claim.rows(transitions=256, steps=400, counted=512) == 0
    one_way = Assumption(0.3, directions="offers")
    assert one_way.rows(transitions=512, steps=512, counted=512) == 85


CHAINS = {  # e_G, e_B, mean burst: Q by the chain and by eps_inf, for 512 and 8192 copies
    (0.0, 1.0, 5): (17, 1774, 7, 531),
    (0.1, 0.9, 5): (40, 1894, 28, 1032),
    (0.1, 0.9, 100): (12, 772, 12, 654),
}


def chain(loss_good: float, loss_bad: float, burst: float, mean: float = 0.3) -> GilbertElliott:
    to_good = 1 / burst
    bad = (mean - loss_good) / (loss_bad - loss_good)
    return GilbertElliott(loss_good, loss_bad, to_good * bad / (1 - bad), to_good)


@pytest.mark.parametrize("shape", CHAINS)
def test_bursts_leave_less_than_their_mean(shape: tuple[float, float, int]) -> None:
    bursts = chain(*shape)
    assert bursts.mean == pytest.approx(0.3)
    by_chain, by_chain_long, by_inf, by_inf_long = CHAINS[shape]
    assert bursts.quantile(512, 1e-12) == by_chain
    assert quantile(512, bursts.eps_inf, 1e-12) == by_inf
    assert quantile(8192, bursts.eps_inf, 1e-12) == by_inf_long
    assert by_inf <= by_chain < quantile(512, 0.3, 1e-12)
    if shape[2] == 5:
        assert bursts.quantile(8192, 1e-12) == by_chain_long


def test_a_chain_without_bursts_is_the_binomial() -> None:
    flat = GilbertElliott(0.3, 0.3, 0.2, 0.4)
    assert flat.eps_inf == pytest.approx(0.3)
    assert flat.tails(512, 90)[85] == pytest.approx(binom.cdf(84, 512, 0.3), rel=1e-9)
    assert flat.quantile(512, 1e-12) == 85


def test_the_claim_of_independent_misses_fails_in_bursts() -> None:
    assert chain(0.0, 1.0, 5).tails(512, 85)[85] > 1e-3  # claimed: 1e-12


@given(n=st.integers(1, 2000), data=st.data())
def test_the_bounds_on_a_measured_rate_are_clopper_and_pearsons(
    n: int, data: st.DataObject
) -> None:
    k = data.draw(st.integers(0, n))
    low, high = clopper_pearson(k, n, 1e-6)
    assert low <= k / n <= high
    if k > 0:
        assert low == pytest.approx(beta.ppf(1e-6, k, n - k + 1), rel=1e-6)
    if k < n:
        assert high == pytest.approx(beta.ppf(1 - 1e-6, k + 1, n - k), rel=1e-6)


def test_half_of_each_missed_nonce_unheard_is_half_the_rows() -> None:
    whole, half = Assumption(0.3), Assumption(0.3, unheard_bits=128)
    assert (whole.rows(256, 256, 512), half.rows(256, 256, 512)) == (85, 42)
    assert half.rows(256, 260, 512) == (85 - 8) // 2
    assert Assumption(0.3, unheard_bits=16).rows(256, 256, 512) == 85 // 16
    assert "128 bits of the nonce" in half.sentence()
    assert "nonce" not in whole.sentence()
    schedule = schedule_of(Assumption(0.02, unheard_bits=128))
    assert schedule is not None
    assert schedule.largest == 1024  # where the field ends
    for eps_E in (0.02, 0.3, 0.9, 0.999):
        claim = Assumption(eps_E, unheard_bits=240)
        found = schedule_of(claim)
        assert found is not None
        n = found.largest
        assert 16 * (2 * n + claim.rows(n, n, 2 * n)) <= 1 << 16
