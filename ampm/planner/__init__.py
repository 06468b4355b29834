"""Plans in closed form: pendulum laws, contacts, feet."""
