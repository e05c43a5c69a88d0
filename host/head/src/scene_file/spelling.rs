//! Misspelt words.

/// The known key that is spelled almost like `key`: two letters in five may differ.
pub fn nearest<'a>(key: &str, known: &[&'a str]) -> Option<&'a str> {
    let distance = |candidate: &str| strsim::damerau_levenshtein(key, candidate);
    let best = known.iter().copied().min_by_key(|candidate| distance(candidate))?;
    (5 * distance(best) <= 2 * best.chars().count()).then_some(best)
}
