"""What both ends of the link must agree on: messages, automata, agreement, exactly-once rules."""
