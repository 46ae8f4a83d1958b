"""Where keys live: stores and ledgers on disk, and the process that makes keys."""
