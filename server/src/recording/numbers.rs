//! Matches pictures of different folders by the numbers in their file names, and sorts names in natural order.

use std::cmp::Ordering;
use std::collections::HashMap;

/// Natural order: runs of digits are compared by value, so that `cam0_2` comes before `cam0_10`.
pub(super) fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut a_rest, mut b_rest) = (a, b);
    loop {
        let ((a_run, a_next), (b_run, b_next)) = (split_run(a_rest), split_run(b_rest));
        if a_run.is_empty() || b_run.is_empty() {
            return a_run.len().cmp(&b_run.len()).then(a.cmp(b));
        }
        let by_run = match (is_digits(a_run), is_digits(b_run)) {
            (true, true) => by_value(a_run, b_run),
            _ => a_run.cmp(b_run),
        };
        if by_run != Ordering::Equal {
            return by_run;
        }
        (a_rest, b_rest) = (a_next, b_next);
    }
}

/// The first run of digits or of other characters, and the rest.
fn split_run(text: &str) -> (&str, &str) {
    let digits = is_digits(text);
    let end = text.find(|c: char| c.is_ascii_digit() != digits);
    text.split_at(end.unwrap_or(text.len()))
}

fn is_digits(run: &str) -> bool {
    run.starts_with(|c: char| c.is_ascii_digit())
}

/// Compares two runs of digits of any length.
fn by_value(a: &str, b: &str) -> Ordering {
    let (a, b) = (a.trim_start_matches('0'), b.trim_start_matches('0'));
    a.len().cmp(&b.len()).then(a.cmp(b))
}

/// The numbers that distinguish the names of a folder: the run of digits that counts the pictures or, if no single
/// run does (seconds and their fraction, a date and a count), all runs that vary. Numbers that are the same in all
/// names, such as dates and cameras, are ignored. `None` if the names have no numbers, or share them.
pub(super) fn keys(names: &[&str]) -> Option<Vec<Vec<u64>>> {
    let runs: Option<Vec<Vec<u64>>> = names.iter().map(|name| numbers_in(stem(name))).collect();
    let runs = runs?;
    let n_runs = runs.first()?.len();
    if n_runs == 0 || runs.iter().any(|run| run.len() != n_runs) {
        return None;
    }
    let varies = |i: usize| runs.iter().any(|run| run[i] != runs[0][i]);
    let distinct = |keys: &[Vec<u64>]| {
        let set: std::collections::HashSet<_> = keys.iter().collect();
        set.len() == keys.len()
    };
    let only = |picked: &[usize]| -> Vec<Vec<u64>> {
        let of = |run: &Vec<u64>| picked.iter().map(|&i| run[i]).collect();
        runs.iter().map(of).collect()
    };
    let varying: Vec<usize> = (0..n_runs).filter(|&i| varies(i)).collect();
    if varying.is_empty() {
        // One picture, or several with the same number.
        return Some(only(&[n_runs - 1])).filter(|keys| distinct(keys));
    }
    // The last run that distinguishes all names by itself, because names usually end in their number.
    let counting = varying.iter().rev().map(|&i| only(&[i]));
    counting.chain([only(&varying)]).find(|keys| distinct(keys))
}

fn stem(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// Runs of digits as numbers; `None` if one exceeds u64.
fn numbers_in(text: &str) -> Option<Vec<u64>> {
    text.split(|c: char| !c.is_ascii_digit())
        .filter(|run| !run.is_empty())
        .map(|run| run.parse().ok())
        .collect()
}

/// How two lists were matched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rule {
    /// By the same number.
    Number,
    /// By numbers with a constant difference: one side counts from 0, the other from 1.
    Shifted(i64),
    /// By order, the first with the first.
    Order,
}

impl Rule {
    /// Description for people of how pictures were matched.
    pub(super) fn name(self) -> String {
        match self {
            Self::Number => "by number".to_owned(),
            Self::Shifted(by) => {
                format!("by number, {by:+} (one side counts from 0, the other from 1)")
            }
            Self::Order => "by order".to_owned(),
        }
    }
}

/// Matches items of two sorted lists by keys, which are distinct if known. Returns for each item of `a` the position
/// of its counterpart in `b`, if any, and the rule. `None` if no rule applies: unknown numbers or numbers without any
/// in common, and different counts.
pub(super) fn matched(
    a: Option<&[Vec<u64>]>,
    b: Option<&[Vec<u64>]>,
    n: [usize; 2],
) -> Option<(Vec<Option<usize>>, Rule)> {
    let by_order = || {
        let pairs = (0..n[0]).map(Some).collect();
        (n[0] == n[1]).then_some((pairs, Rule::Order))
    };
    let (Some(a), Some(b)) = (a, b) else {
        return by_order();
    };
    let places: HashMap<&[u64], usize> = b
        .iter()
        .enumerate()
        .map(|(i, key)| (key.as_slice(), i))
        .collect();
    let by_number = |shift: i64| -> Vec<Option<usize>> {
        let moved = |key: &Vec<u64>| match key.as_slice() {
            [one] if shift != 0 => Some(vec![one.checked_add_signed(shift)?]),
            _ => Some(key.clone()),
        };
        a.iter()
            .map(|key| places.get(moved(key)?.as_slice()).copied())
            .collect()
    };
    let pairs = by_number(0);
    let found = pairs.iter().flatten().count();
    if found == n[0] || found == n[1] {
        return Some((pairs, Rule::Number));
    }
    // Numbers that agree only in part may be two different countings of the same pictures.
    let one = |keys: &[Vec<u64>]| -> Option<Vec<u64>> {
        let number = |key: &Vec<u64>| (key.len() == 1).then(|| key[0]);
        keys.iter().map(number).collect()
    };
    if let (Some(a), Some(b)) = (one(a), one(b)) {
        if n[0] == n[1] && (same_steps(&a, &b) || counts_up(&b) || counts_up(&a)) {
            return by_order();
        }
        let (from_a, from_b) = (a.iter().min(), b.iter().min());
        let shift = match (from_a, from_b) {
            (Some(1..), Some(0)) => -1,
            (Some(0), Some(1)) => 1,
            _ => 0,
        };
        let shifted = by_number(shift);
        if shift != 0 && shifted.iter().all(Option::is_some) {
            return Some((shifted, Rule::Shifted(shift)));
        }
    }
    if found > 0 {
        return Some((pairs, Rule::Number));
    }
    by_order()
}

/// Whether numbers are a plain count from 0 or 1, which contains no more information than the order.
fn counts_up(numbers: &[u64]) -> bool {
    let first = numbers.first().copied().unwrap_or(2);
    first <= 1
        && (first..)
            .zip(numbers)
            .all(|(count, &number)| count == number)
}

/// Whether the differences in one list are those in the other, up to a constant factor.
fn same_steps(a: &[u64], b: &[u64]) -> bool {
    let step = |list: &[u64], i: usize| i128::from(list[i + 1]) - i128::from(list[i]);
    let n = a.len().min(b.len()).saturating_sub(1);
    // Any single step is proportional to any other.
    let moved = (0..n).all(|i| step(a, i) == step(b, i));
    moved || (n >= 2 && (0..n).all(|i| step(a, i) * step(b, 0) == step(b, i) * step(a, 0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The number of each name in a folder, if a single number distinguishes them.
    fn counts(names: &[&str]) -> Option<Vec<u64>> {
        keys(names)?
            .into_iter()
            .map(|key| match key.as_slice() {
                [number] => Some(*number),
                _ => None,
            })
            .collect()
    }

    #[test]
    fn names_are_ordered_as_people_count() {
        let mut names = ["cam0_10", "cam0_2", "cam0_1", "b", "cam0_02", "", "cam10_0"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(
            names,
            ["", "b", "cam0_1", "cam0_02", "cam0_2", "cam0_10", "cam10_0"]
        );
    }

    #[test]
    fn the_number_that_counts_is_found() {
        for (names, expected) in [
            (
                ["000000.png", "000001.png", "000010.png"],
                Some(vec![0, 1, 10]),
            ),
            (
                [
                    "2024-01-05_0001.png",
                    "2024-01-05_0002.png",
                    "2024-01-05_0003.png",
                ],
                Some(vec![1, 2, 3]),
            ),
            (
                [
                    "2024-01-05_0009.png",
                    "2024-01-06_0010.png",
                    "2024-01-06_0011.png",
                ],
                Some(vec![9, 10, 11]),
            ),
            (
                ["cam0_2.png", "cam0_10.png", "cam0_7.png"],
                Some(vec![2, 10, 7]),
            ),
            (
                ["1_left.png", "2_left.png", "3_left.png"],
                Some(vec![1, 2, 3]),
            ),
            (["a.png", "b.png", "c.png"], None),
            (["a1.png", "b1.png", "c1.png"], None),
            (["1.png", "2 (1).png", "3.png"], None),
            // Neither seconds nor fractions alone are distinct, but both together are.
            (["5.1.png", "5.2.png", "6.1.png"], None),
        ] {
            assert_eq!(counts(&names), expected, "{names:?}");
        }
        assert_eq!(
            keys(&["5.1.png", "5.2.png", "6.1.png"]),
            Some(vec![vec![5, 1], vec![5, 2], vec![6, 1]])
        );
        assert_eq!(counts(&["2024_7.png"]), Some(vec![7]));
        assert_eq!(counts(&["99999999999999999999.png"]), None);
    }

    /// Matches lists of numbers.
    fn match_counts(a: &[u64], b: &[u64]) -> (Vec<Option<usize>>, Rule) {
        let keys = |list: &[u64]| -> Vec<Vec<u64>> { list.iter().map(|&n| vec![n]).collect() };
        matched(Some(&keys(a)), Some(&keys(b)), [a.len(), b.len()]).unwrap()
    }

    #[test]
    fn numbers_are_matched_with_numbers_or_by_order() {
        let all = |n: usize| (0..n).map(Some).collect::<Vec<_>>();
        // The same numbers, of any values; more entries than pictures; fewer entries.
        assert_eq!(
            match_counts(&[0, 10, 20], &[0, 10, 20]),
            (all(3), Rule::Number)
        );
        assert_eq!(match_counts(&[1, 2, 3], &[1, 2, 3]), (all(3), Rule::Number));
        let every_tenth: Vec<u64> = (0..30).collect();
        assert_eq!(
            match_counts(&[0, 10, 20], &every_tenth),
            (vec![Some(0), Some(10), Some(20)], Rule::Number)
        );
        assert_eq!(
            match_counts(&[0, 1, 2, 3], &[0, 1]),
            (vec![Some(0), Some(1), None, None], Rule::Number)
        );
        // Two different countings of the same pictures.
        for (a, b) in [
            ([1, 2, 3, 4], [0, 1, 2, 3]),
            ([0, 1, 2, 3], [1, 2, 3, 4]),
            ([0, 10, 20, 30], [0, 1, 2, 3]),
            ([0, 1, 3, 4], [0, 1, 2, 3]),
            ([0, 3, 6, 9], [0, 1, 2, 3]),
            ([100, 101, 102, 103], [7, 8, 9, 10]),
            ([7, 9, 11, 13], [100, 104, 108, 112]),
        ] {
            assert_eq!(match_counts(&a, &b), (all(4), Rule::Order), "{a:?} {b:?}");
        }
        // A missing number on either side is not a different counting.
        assert_eq!(
            match_counts(&[10, 11, 13, 14], &[10, 11, 12, 14]),
            (vec![Some(0), Some(1), None, Some(3)], Rule::Number)
        );
        // Counts from 1 and from 0, with a picture missing.
        assert_eq!(
            match_counts(&[1, 2, 4, 5], &[0, 1, 2, 3, 4]),
            (vec![Some(0), Some(1), Some(3), Some(4)], Rule::Shifted(-1))
        );
        assert_eq!(
            match_counts(&[0, 1, 3, 4], &[1, 2, 3, 4, 5]),
            (vec![Some(0), Some(1), Some(3), Some(4)], Rule::Shifted(1))
        );
        // No rule applies.
        assert_eq!(matched(None, None, [2, 3]), None);
        assert_eq!(
            matched(Some(&[vec![7]]), Some(&[vec![8], vec![9]]), [1, 2]),
            None
        );
        assert_eq!(matched(None, None, [2, 2]), Some((all(2), Rule::Order)));
    }

    proptest! {
        #[test]
        fn any_names_are_ordered_and_matched(
            names in prop::collection::vec("[a0-9._é]{0,8}", 0..8),
            others in prop::collection::vec("[a0-9._é]{0,8}", 0..8),
        ) {
            let mut names: Vec<&str> = names.iter().map(String::as_str).collect();
            let others: Vec<&str> = others.iter().map(String::as_str).collect();
            // The sort panics if the order is inconsistent.
            names.sort_by(|a, b| natural_order(a, b));
            let (a, b) = (keys(&names), keys(&others));
            if let Some((pairs, _)) = matched(a.as_deref(), b.as_deref(), [names.len(), others.len()]) {
                prop_assert_eq!(pairs.len(), names.len());
                let mut found: Vec<usize> = pairs.into_iter().flatten().collect();
                prop_assert!(found.iter().all(|&i| i < others.len()));
                let n = found.len();
                found.sort_unstable();
                found.dedup();
                prop_assert_eq!(found.len(), n);
            }
        }
    }
}
