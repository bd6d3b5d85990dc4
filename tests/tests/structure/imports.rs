//! Which file of a package imports from which, read from its text.
//!
//! Paths in `use` and in expressions are followed to the file that defines what they name, through re-exports:
//! a re-export itself is no import. Test code is left out. What a macro writes is not seen.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A file's module: its path below the crate's root.
type Module = Vec<String>;

/// Re-exports followed one into the other: more would be a circle of them.
const MOST_HOPS: usize = 16;

/// A package's files and what they name.
pub(super) struct Package {
    files: BTreeMap<Module, File>,
}

struct File {
    path: PathBuf,
    /// Names that its `use` items bind, and the paths they stand for.
    bound: BTreeMap<String, Vec<String>>,
    /// Modules whose every name it takes.
    globs: Vec<Vec<String>>,
    /// What it names itself, re-exports left out.
    named: BTreeSet<Vec<String>>,
    /// Names that it defines.
    defined: BTreeSet<String>,
}

impl Package {
    /// Every file below a source folder but tests.
    pub(super) fn read(source: &Path) -> Self {
        let mut files = BTreeMap::new();
        let mut folders = vec![source.to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).expect("a source folder") {
                let path = entry.expect("an entry").path();
                let name = path
                    .file_stem()
                    .expect("a name")
                    .to_string_lossy()
                    .into_owned();
                if name == "tests" {
                    continue;
                }
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|extension| extension == "rs") {
                    let below = folder.strip_prefix(source).expect("below the source");
                    let mut module: Module = below
                        .iter()
                        .map(|part| part.to_string_lossy().into_owned())
                        .collect();
                    if !["mod", "lib", "main"].contains(&name.as_str()) {
                        module.push(name);
                    }
                    let text = std::fs::read_to_string(&path).expect("a source file");
                    files.insert(module, File::parse(path, &text));
                }
            }
        }
        Self { files }
    }

    /// Files that each file imports from.
    pub(super) fn imports(&self) -> BTreeMap<&Path, BTreeSet<&Path>> {
        let of_file = |(module, file): (&Module, &'_ File)| {
            let targets = file.named.iter();
            let targets = targets.filter_map(|path| self.resolve(module, path, 0));
            targets
                .map(|target| &*self.files[&target].path)
                .filter(|target| *target != file.path)
                .collect()
        };
        let files = self.files.iter();
        files
            .map(|entry| (&*entry.1.path, of_file(entry)))
            .collect()
    }

    /// The file that defines what a path in `module` names; `None` outside of the package.
    fn resolve(&self, module: &[String], path: &[String], hops: usize) -> Option<Module> {
        if hops > MOST_HOPS {
            return None;
        }
        let mut at = module.to_vec();
        let mut rest = path;
        match rest.first()?.as_str() {
            "crate" => {
                at.clear();
                rest = &rest[1..];
            }
            "self" => rest = &rest[1..],
            "super" => {
                while rest.first().is_some_and(|part| part == "super") {
                    at.pop()?;
                    rest = &rest[1..];
                }
            }
            first => {
                // A child, something bound here, or another package.
                let file = self.files.get(module)?;
                let child = [module, &[first.to_owned()]].concat();
                let bound = file.bound.contains_key(first) && hops > 0;
                if !self.files.contains_key(&child) && !bound {
                    return None;
                }
            }
        }
        while let Some(part) = rest.first() {
            let child = [&at[..], std::slice::from_ref(part)].concat();
            if self.files.contains_key(&child) {
                at = child;
                rest = &rest[1..];
                continue;
            }
            let file = self.files.get(&at)?;
            if file.defined.contains(part) {
                break;
            }
            if let Some(target) = file.bound.get(part) {
                let path = [&target[..], &rest[1..]].concat();
                return self.resolve(&at, &path, hops + 1);
            }
            let through = |glob: &Vec<String>| {
                let target = self.resolve(&at, glob, hops + 1)?;
                let has = |name: &str| {
                    let file = &self.files[&target];
                    file.defined.contains(name) || file.bound.contains_key(name)
                };
                has(part).then(|| {
                    self.resolve(&target, &[&["self".to_owned()], rest].concat(), hops + 1)
                })?
            };
            return file.globs.iter().find_map(through).or(Some(at));
        }
        self.files.contains_key(&at).then_some(at)
    }
}

impl File {
    fn parse(path: PathBuf, text: &str) -> Self {
        let tokens = without_tests(&tokens(text));
        let mut file = Self {
            path,
            bound: BTreeMap::new(),
            globs: Vec::new(),
            named: BTreeSet::new(),
            defined: BTreeSet::new(),
        };
        let mut i = 0;
        while i < tokens.len() {
            match tokens[i].as_str() {
                "use" => {
                    let end = (i..tokens.len())
                        .find(|&k| tokens[k] == ";")
                        .unwrap_or(tokens.len());
                    let exported = i > 0 && (tokens[i - 1] == "pub" || tokens[i - 1] == ")");
                    file.take(&tokens[i + 1..end], &mut Vec::new(), exported);
                    i = end;
                }
                "struct" | "enum" | "union" | "trait" | "type" | "fn" | "const" | "static"
                | "macro_rules" => {
                    let name = tokens[i + 1..].iter().find(|token| *token != "!");
                    file.defined.extend(name.cloned());
                }
                "crate" | "super" if tokens.get(i + 1).is_some_and(|next| next == "::") => {
                    let mut path = vec![tokens[i].clone()];
                    while tokens.get(i + 1).is_some_and(|next| next == "::")
                        && tokens.get(i + 2).is_some_and(|next| is_name(next))
                    {
                        path.push(tokens[i + 2].clone());
                        i += 2;
                    }
                    file.named.insert(path);
                }
                _ => {}
            }
            i += 1;
        }
        file
    }

    /// Reads one tree of a `use` item.
    fn take(&mut self, tree: &[String], prefix: &mut Vec<String>, exported: bool) {
        let depth = prefix.len();
        let mut i = 0;
        while i < tree.len() {
            match tree[i].as_str() {
                "::" => {}
                "{" => {
                    let end = closing(tree, i);
                    for branch in branches(&tree[i + 1..end]) {
                        self.take(branch, &mut prefix.clone(), exported);
                    }
                    prefix.truncate(depth);
                    return;
                }
                "*" => {
                    self.globs.push(prefix.clone());
                    if !exported {
                        self.named.insert(prefix.clone());
                    }
                    return;
                }
                "as" => {
                    self.bind(prefix, tree.get(i + 1), exported);
                    return;
                }
                name => prefix.push(name.to_owned()),
            }
            i += 1;
        }
        self.bind(prefix, None, exported);
    }

    fn bind(&mut self, path: &[String], alias: Option<&String>, exported: bool) {
        let mut path = path.to_vec();
        if path.len() > 1 && path.last().is_some_and(|last| last == "self") {
            path.pop();
        }
        let Some(name) = alias.or(path.last()).cloned() else {
            return;
        };
        if !exported {
            self.named.insert(path.clone());
        }
        self.bound.insert(name, path);
    }
}

fn is_name(token: &str) -> bool {
    token.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// Index of the brace that closes the one at `open`.
fn closing(tokens: &[String], open: usize) -> usize {
    let mut depth = 0;
    for (i, token) in tokens.iter().enumerate().skip(open) {
        match token.as_str() {
            "{" => depth += 1,
            "}" => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return i;
        }
    }
    tokens.len()
}

/// Parts between the commas outside of braces.
fn branches(tokens: &[String]) -> Vec<&[String]> {
    let mut parts = Vec::new();
    let (mut start, mut depth) = (0, 0);
    for (i, token) in tokens.iter().enumerate() {
        match token.as_str() {
            "{" => depth += 1,
            "}" => depth -= 1,
            "," if depth == 0 => {
                parts.push(&tokens[start..i]);
                start = i + 1;
            }
            _ => {}
        }
    }
    parts.push(&tokens[start..]);
    parts.retain(|part| !part.is_empty());
    parts
}

/// Names, `::` and single signs; comments, strings, characters and lifetimes left out.
fn tokens(text: &str) -> Vec<String> {
    let chars: Vec<char> = text.chars().collect();
    let at = |i: usize| chars.get(i).copied().unwrap_or('\0');
    let mut tokens = Vec::new();
    let mut i = 0;
    while i < chars.len() {
        let c = chars[i];
        if c == '/' && at(i + 1) == '/' {
            while i < chars.len() && chars[i] != '\n' {
                i += 1;
            }
        } else if c == 'r'
            && (at(i + 1) == '"' || (at(i + 1) == '#' && matches!(at(i + 2), '"' | '#')))
        {
            let hashes = chars[i + 1..].iter().take_while(|&&c| c == '#').count();
            i += hashes + 2;
            let closes = |i: usize| at(i) == '"' && (1..=hashes).all(|k| at(i + k) == '#');
            while i < chars.len() && !closes(i) {
                i += 1;
            }
            i += hashes + 1;
        } else if c == '"' {
            i += 1;
            while i < chars.len() && chars[i] != '"' {
                i += if chars[i] == '\\' { 2 } else { 1 };
            }
            i += 1;
        } else if c == '\'' {
            // A character, or a lifetime.
            if at(i + 1) == '\\' {
                i += 3;
                while i < chars.len() && chars[i] != '\'' {
                    i += 1;
                }
                i += 1;
            } else {
                i += if at(i + 2) == '\'' { 3 } else { 1 };
            }
        } else if c.is_alphanumeric() || c == '_' {
            let start = i;
            while i < chars.len() && (chars[i].is_alphanumeric() || chars[i] == '_') {
                i += 1;
            }
            tokens.push(chars[start..i].iter().collect());
        } else if c == ':' && at(i + 1) == ':' {
            tokens.push("::".to_owned());
            i += 2;
        } else {
            if !c.is_whitespace() {
                tokens.push(c.to_string());
            }
            i += 1;
        }
    }
    tokens
}

/// Leaves out what stands under `#[cfg(test)]`.
fn without_tests(tokens: &[String]) -> Vec<String> {
    let mark = ["#", "[", "cfg", "(", "test", ")", "]"];
    let mut kept = Vec::new();
    let mut i = 0;
    while i < tokens.len() {
        if tokens[i..].len() >= mark.len() && tokens[i..].iter().zip(mark).all(|(a, b)| a == b) {
            // To the end of the item: a semicolon, or the brace that closes its first.
            let end = (i..tokens.len()).find(|&k| tokens[k] == ";" || tokens[k] == "{");
            i = match end {
                Some(k) if tokens[k] == "{" => closing(tokens, k) + 1,
                Some(k) => k + 1,
                None => tokens.len(),
            };
        } else {
            kept.push(tokens[i].clone());
            i += 1;
        }
    }
    kept
}

/// Sets of two or more files each of which reaches all others of its set.
pub(super) fn circles<'a>(
    imports: &BTreeMap<&'a Path, BTreeSet<&'a Path>>,
) -> Vec<BTreeSet<&'a Path>> {
    let reached = |from: &'a Path| {
        let mut reached: BTreeSet<&'a Path> = BTreeSet::new();
        let mut open = vec![from];
        while let Some(file) = open.pop() {
            for &next in imports.get(file).into_iter().flatten() {
                if reached.insert(next) {
                    open.push(next);
                }
            }
        }
        reached
    };
    let reach: BTreeMap<&'a Path, BTreeSet<&'a Path>> =
        imports.keys().map(|&file| (file, reached(file))).collect();
    let mut found: Vec<BTreeSet<&'a Path>> = Vec::new();
    for (&file, reached) in &reach {
        let back = |other: &&&'a Path| reach.get(**other).is_some_and(|r| r.contains(file));
        let circle: BTreeSet<&'a Path> = reached.iter().filter(back).copied().collect();
        if circle.len() > 1 && !found.contains(&circle) {
            found.push(circle);
        }
    }
    found
}

/// Which of some paths or names a file uses outside of tests, in `use` items or anywhere else.
pub(super) fn names_any<'a>(path: &Path, forbidden: &[&'a str]) -> Vec<&'a str> {
    let text = std::fs::read_to_string(path).expect("a source file");
    let tokens = without_tests(&tokens(&text));
    let file = File::parse(path.to_owned(), &text);
    let mut written = vec![tokens];
    let with_signs = |path: &Vec<String>| path.join(" :: ").split(' ').map(str::to_owned).collect();
    written.extend(file.bound.values().chain(&file.globs).map(with_signs));
    let uses = |name: &&&str| {
        let name: Vec<String> = name
            .replace("::", " :: ")
            .split(' ')
            .map(str::to_owned)
            .collect();
        written
            .iter()
            .any(|tokens| tokens.windows(name.len()).any(|part| *part == *name))
    };
    forbidden.iter().filter(uses).copied().collect()
}
