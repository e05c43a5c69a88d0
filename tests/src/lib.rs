//! What several whole-chain tests share: reference tables and scenes.

pub mod reference;
