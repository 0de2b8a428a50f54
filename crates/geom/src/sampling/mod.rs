//! Sample patterns.
