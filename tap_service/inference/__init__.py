"""What can be inferred from a transcript: decodings, models, states that were missed."""
