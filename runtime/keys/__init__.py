"""Where keys live: stores on disk, and the process that makes keys."""
