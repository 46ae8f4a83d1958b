"""A multicast group of several sessions that listen to the same keys stays quiet."""

from runtime.zenoh_bus import ZenohBus

GROUP = "224.0.0.231"
MEASUREMENT, OFFER = "wyner/v3/loop/field/measurement", "wyner/v3/loop/field/offer"


def test_in_a_group_no_two_spell_a_key_alike_and_all_mean_the_same() -> None:
    import zenoh

    with ZenohBus(listen=[f"udp/{GROUP}:20000#iface=lo"]) as bus:
        exact, every_loop = MEASUREMENT, "wyner/v3/*/field/offer"
        spelled = {bus.spelling(exact) for _ in range(100)}
        assert len(spelled) == 100
        assert all(zenoh.KeyExpr(one).includes(exact) for one in spelled)
        assert all(not zenoh.KeyExpr(one).intersects(OFFER) for one in spelled)
        assert zenoh.KeyExpr(bus.spelling(every_loop)).includes(every_loop)
    with ZenohBus() as alone:
        assert alone.spelling(exact) == exact
