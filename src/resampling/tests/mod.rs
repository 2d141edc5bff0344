//! Laws and exact expectations of the core.
