//! Checks which web pages may connect (origin) and under which host names (`Host`).
//!
//! Any page can make a browser connect to any address, and the owner of a page can let its host name resolve to
//! this machine ("DNS rebinding"). Browsers state origin and host in headers.

use std::net::IpAddr;

use axum::http::{HeaderMap, HeaderName, header};

use super::config::ServeConfig;

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name).map(|v| v.to_str().unwrap_or(""))
}

/// The `Host` header without the port.
fn name_of(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) && !name.is_empty() => {
            // A bare IPv6 address has no port.
            if name.contains(':') && !name.ends_with(']') {
                host
            } else {
                name
            }
        }
        _ => host,
    }
}

/// Whether every browser resolves this name to its own machine.
fn is_local(name: &str) -> bool {
    let name = name.strip_suffix('.').unwrap_or(name).to_ascii_lowercase();
    let address = name.strip_prefix('[').and_then(|n| n.strip_suffix(']'));
    name == "localhost"
        || name.ends_with(".localhost")
        || address
            .unwrap_or(&name)
            .parse::<IpAddr>()
            .is_ok_and(|ip| ip.to_canonical().is_loopback())
}

/// Whether the origin of a request may connect. Browsers send the page's origin with a request of any page; only
/// the server's own pages may connect. Clients that are not browsers send none. A server on this machine must
/// also be addressed by a local name, or a foreign name that resolves to it would pass for its own.
pub(super) fn origin_allowed(headers: &HeaderMap, config: &ServeConfig) -> bool {
    let Some(origin) = text(headers, header::ORIGIN) else {
        return true;
    };
    if config.origins.iter().any(|a| a == "*" || a == origin) {
        return true;
    }
    let Some(host) = text(headers, header::HOST) else {
        return false;
    };
    let authority = origin.split_once("://").map(|(_, authority)| authority);
    if authority.is_none_or(|a| !a.eq_ignore_ascii_case(host)) {
        return false;
    }
    is_local(name_of(host)) || !config.listen.is_loopback()
}

/// Whether a request without the token may be answered under its host name; `Err` is that name. If the server has
/// a token, the token decides instead.
pub(super) fn host_allowed<'a>(
    headers: &'a HeaderMap,
    config: &ServeConfig,
) -> Result<(), &'a str> {
    // Only clients that are not browsers may omit it, and DNS rebinding does not concern them.
    let Some(host) = text(headers, header::HOST) else {
        return Ok(());
    };
    if config.token.is_some() || is_local(name_of(host)) {
        return Ok(());
    }
    let own = name_of(host).trim_matches(['[', ']']).parse::<IpAddr>();
    // The origin of a page that may connect may also be this server's own, behind a proxy.
    let proxied = config.origins.iter().any(|origin| {
        let authority = origin.split_once("://").map(|(_, authority)| authority);
        origin == "*" || authority.is_some_and(|a| a.eq_ignore_ascii_case(host))
    });
    match proxied || own.is_ok_and(|ip| config.listen.contains(ip)) {
        true => Ok(()),
        false => Err(host),
    }
}

/// Content security policy of the page: scripts from this server only, pictures also from blobs, where the
/// decoder puts them, and connections only to the host that served it.
pub(super) fn page_policy(headers: &HeaderMap) -> String {
    // Some browsers do not count WebSockets as `'self'`.
    let host = text(headers, header::HOST).filter(|host| {
        let plain = |b: u8| b.is_ascii_alphanumeric() || b".-:[]_".contains(&b);
        !host.is_empty() && host.bytes().all(plain)
    });
    let sockets = host.map(|host| format!(" ws://{host} wss://{host}"));
    format!(
        "default-src 'self'; connect-src 'self'{}; img-src 'self' blob: data:; \
         worker-src 'self' blob:; base-uri 'none'; frame-ancestors 'none'",
        sockets.unwrap_or_default()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;
    use std::net::SocketAddr;

    fn config(listen: [u8; 4], token: bool, origins: &[&str]) -> ServeConfig {
        ServeConfig {
            listen: SocketAddr::from((IpAddr::from(listen), 8080)).into(),
            token: token.then(|| "secret".to_owned()),
            origins: origins.iter().map(|o| (*o).to_owned()).collect(),
            ..ServeConfig::local(0)
        }
    }

    fn headers(host: &'static str, origin: Option<&'static str>) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, HeaderValue::from_static(host));
        if let Some(origin) = origin {
            headers.insert(header::ORIGIN, HeaderValue::from_static(origin));
        }
        headers
    }

    #[test]
    fn only_the_servers_own_pages_connect() {
        let (local, public) = ([127, 0, 0, 1], [0, 0, 0, 0]);
        for (origin, host, listen, expected) in [
            (None, "127.0.0.1:8080", local, true),
            (Some("http://127.0.0.1:8080"), "127.0.0.1:8080", local, true),
            (Some("http://localhost:8080"), "localhost:8080", local, true),
            (Some("http://[::1]:8080"), "[::1]:8080", local, true),
            (Some("http://evil.example"), "127.0.0.1:8080", local, false),
            // A foreign name that resolves to this machine.
            (
                Some("http://evil.example:8080"),
                "evil.example:8080",
                local,
                false,
            ),
            (Some("http://ghost.example"), "ghost.example", public, true),
            (
                Some("http://ghost.example:81"),
                "ghost.example",
                public,
                false,
            ),
            (Some("null"), "127.0.0.1:8080", local, false),
            (Some("https://page.example"), "ghost.example", public, true),
        ] {
            let config = config(listen, false, &["https://page.example"]);
            let got = origin_allowed(&headers(host, origin), &config);
            assert_eq!(got, expected, "{origin:?} to {host}");
        }
    }

    #[test]
    fn without_a_token_only_names_of_this_machine_are_answered() {
        let local = config([127, 0, 0, 1], false, &["https://page.example"]);
        for host in [
            "localhost",
            "LOCALHOST:8080",
            "localhost.:8080",
            "ghost.localhost:80",
            "127.0.0.1:8080",
            "127.9.9.9",
            "[::1]:8080",
            "[::ffff:127.0.0.1]:8080",
            // A name given by the user who started the server.
            "page.example",
        ] {
            assert_eq!(host_allowed(&headers(host, None), &local), Ok(()), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:8080",
            "localhost.evil.example",
            "127.0.0.1.evil.example:8080",
            "192.168.0.7:8080",
            "10.0.0.1",
            "[2001:db8::1]:8080",
            "",
            ":8080",
        ] {
            let headers = headers(host, None);
            assert_eq!(host_allowed(&headers, &local), Err(host), "{host}");
        }
        let open = config([0, 0, 0, 0], true, &[]);
        assert_eq!(host_allowed(&headers("ghost.example", None), &open), Ok(()));
        assert_eq!(host_allowed(&HeaderMap::new(), &local), Ok(()));
    }

    #[test]
    fn the_page_connects_to_its_own_host_alone() {
        let policy = page_policy(&headers("ghost.example:8080", None));
        let connect = policy.split("; ").find(|p| p.starts_with("connect-src"));
        assert_eq!(
            connect,
            Some("connect-src 'self' ws://ghost.example:8080 wss://ghost.example:8080")
        );
        for host in ["a; script-src *", "a b", "a,b", ""] {
            let policy = page_policy(&headers(host, None));
            assert!(policy.contains("connect-src 'self';"), "{policy}");
        }
    }
}
