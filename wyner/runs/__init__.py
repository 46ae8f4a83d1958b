"""A finished or cut-off run: one reader of its folder, and what is made of it."""
