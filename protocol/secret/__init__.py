"""Keys with a proof: nonces that a tap may miss, the bound on how many, and what is made of them.

What no eavesdropper can be promised to miss makes no key: the assumption (``eps_E``) is the
operator's, stated in the scenario; everything else here is counting. The claim and its proof are in
docs/keys.md.
"""
