//! An STM32G474 in software, with light and electronics around it.
