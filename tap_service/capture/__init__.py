"""What the tap hears: the recording, the channel it came through, the transcript."""
