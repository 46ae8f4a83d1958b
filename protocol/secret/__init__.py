"""Keys with a proof: nonces that a tap may miss, the bound on how many, and what is made of them.

The operator states in the scenario what every tap misses (``eps_E``). Everything else here is
counting. Without that assumption no key is made. The claim and its proof are in docs/keys.md.
"""
