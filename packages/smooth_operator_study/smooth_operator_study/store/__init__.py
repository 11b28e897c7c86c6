"""Store of a study: events in a database, and the state that follows from them."""
